//! Pulse trains to crossing times, streaming over chunks.
