//! Threads for a batch.

use crate::error::{Error, Result, require};

/// More than any machine that this runs on has cores for.
const MOST_THREADS: usize = 1024;

/// Run `work` on `threads` threads of its own, 0 for all cores.
///
/// Rayon's global pool would do for 0, but its threads don't survive a fork, and `multiprocessing` forks.
///
/// # Errors
/// What `work` returns, or [`Error::Internal`] where the system gives no threads.
pub fn on_threads<T: Send>(threads: usize, work: impl FnOnce() -> Result<T> + Send) -> Result<T> {
    require(threads <= MOST_THREADS, || {
        format!("threads is {threads}, expected up to {MOST_THREADS}, 0 for all cores")
    })?;
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|error| Error::Internal(format!("can't start {threads} threads: {error}")))?
        .install(work)
}
