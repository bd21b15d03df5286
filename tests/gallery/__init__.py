"""A gallery of bad inputs: slips in every key of the files and in every option, from a grammar of slips."""
