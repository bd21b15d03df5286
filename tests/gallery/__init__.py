"""A gallery of bad inputs: slips in every key of the files and in every option, from a grammar of slips.

`tests/cli/test_gallery.py` runs each through the command line's own frame and names those that break the contract.
"""
