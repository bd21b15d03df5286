"""The main job: a trial file to a folder of results."""
