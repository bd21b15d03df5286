//! Allocation of sizes that depend on arguments: failure is an error instead of the end of the process.

use crate::error::{Error, Result};

/// Allocate zeros.
///
/// # Errors
/// [`Error::Memory`] if the system has not enough memory.
pub fn zeros(count: usize) -> Result<Vec<f64>> {
    let mut values = Vec::new();
    reserve(&mut values, count)?;
    values.resize(count, 0.0);
    Ok(values)
}

/// Reserve capacity for more values.
///
/// # Errors
/// [`Error::Memory`] if the system has not enough memory.
pub fn reserve<T>(values: &mut Vec<T>, more: usize) -> Result<()> {
    values.try_reserve(more).map_err(|_| Error::Memory { bytes: more.saturating_mul(size_of::<T>()) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_there_is_no_room_for_is_an_error() {
        assert_eq!(zeros(3), Ok(vec![0.0; 3]));
        assert_eq!(zeros(usize::MAX / 4), Err(Error::Memory { bytes: usize::MAX }));
    }
}
