"""A gallery of bad inputs: slips in every key of the files and in every option, from a grammar of slips.

`python -m tests.gallery --inputs 10000` makes them, runs each through the command line's own frame and prints what became
of them; `--seed` makes others, `--show` prints those that broke the contract.
"""
