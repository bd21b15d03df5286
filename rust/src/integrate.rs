//! Fixed-step integration of the plant: single runs and batches.
