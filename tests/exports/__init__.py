"""Hand-over of fingerprints to other tools."""
