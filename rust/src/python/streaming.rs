//! Objects that process their input piece by piece.

use pyo3::prelude::*;

use super::guard;
use crate::error::{Error, Result};
use crate::stop::Stop;

/// A kernel with a state, and whether that state is valid.
pub struct Streaming<K> {
    kernel: K,
    /// Why the kernel can't be used any more.
    ended: Option<&'static str>,
}

impl<K: Send> Streaming<K> {
    /// A kernel before its first piece.
    pub const fn new(kernel: K) -> Self {
        Self { kernel, ended: None }
    }

    /// Read access to the kernel.
    pub fn kernel(&self) -> PyResult<&K> {
        self.require_whole()?;
        Ok(&self.kernel)
    }

    /// Process a piece; a stop or a panic meanwhile leaves an invalid state, and the object refuses further calls.
    pub fn run<T: Send>(
        &mut self,
        py: Python<'_>,
        work: usize,
        piece: impl FnOnce(&mut K, &Stop) -> Result<T> + Send,
    ) -> PyResult<T> {
        self.require_whole()?;
        self.ended = Some("was stopped amid a piece");
        let kernel = &mut self.kernel;
        // Arguments refused before the first sample do not change the state.
        let result = guard::run(py, work, |stop| match piece(kernel, stop) {
            Err(Error::Invalid(message)) => Ok(Err(Error::Invalid(message))),
            other => other.map(Ok),
        })?;
        self.ended = None;
        Ok(result?)
    }

    /// Accept no more pieces.
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
