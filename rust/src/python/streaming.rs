//! Objects that take their input piece by piece.

use pyo3::prelude::*;

use super::guard;
use crate::error::{Error, Result};
use crate::stop::Stop;

/// A kernel with a state, and whether that state is still whole.
pub struct Streaming<K> {
    kernel: K,
    /// Why it can't be used any more.
    ended: Option<&'static str>,
}

impl<K: Send> Streaming<K> {
    /// Before the first piece.
    pub const fn new(kernel: K) -> Self {
        Self { kernel, ended: None }
    }

    /// What can be read of it.
    pub fn kernel(&self) -> PyResult<&K> {
        self.require_whole()?;
        Ok(&self.kernel)
    }

    /// Run one piece; a stop or a panic amid it leaves a state that means nothing, and the object refuses all that follows.
    pub fn run<T: Send>(
        &mut self,
        py: Python<'_>,
        work: usize,
        piece: impl FnOnce(&mut K, &Stop) -> Result<T> + Send,
    ) -> PyResult<T> {
        self.require_whole()?;
        self.ended = Some("was stopped amid a piece");
        let kernel = &mut self.kernel;
        // What is refused before the first sample changes nothing.
        let result = guard::run(py, work, |stop| match piece(kernel, stop) {
            Err(Error::Invalid(message)) => Ok(Err(Error::Invalid(message))),
            other => other.map(Ok),
        })?;
        self.ended = None;
        Ok(result?)
    }

    /// Take no more pieces.
    pub const fn finish(&mut self) {
        self.ended = Some("is finished");
    }

    fn require_whole(&self) -> PyResult<()> {
        match self.ended {
            None => Ok(()),
            Some(why) => {
                Err(Error::Invalid(format!("this object {why}; make a new one and feed it again")).into())
            }
        }
    }
}
