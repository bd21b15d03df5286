//! Inputs of the kernel, and constants of all blocks.

use pulp::Simd;

use super::complex::Complex;
use super::equations::{COUNT, DEGREES, Equations, ORDERS, signal};
use crate::error::{Result, require};

/// Frequencies that are computed together; a record is padded to a multiple.
pub const BLOCK: usize = 32;

/// Most outputs.
pub const MOST: usize = 4;

/// Spectra of a record, [S, ORDERS, 2, F]: signals as in `SIGNALS`, orders of the taper with signs, real and imaginary
/// parts.
#[derive(Debug, Clone, Copy)]
pub struct Spectra<'a> {
    /// Values of all spectra.
    pub values: &'a [f64],
    /// Number of frequencies, padded.
    pub count: usize,
    /// Frequency spacing [rad/s].
    pub spacing: f64,
}

/// A signal delayed by a multiple of a grid, [ORDERS, 2, F], and the remaining delay [s].
#[derive(Debug, Clone, Copy)]
pub struct Late<'a> {
    /// Spectra of all orders.
    pub values: &'a [f64],
    /// Remaining delay [s].
    pub rest: f64,
}

impl Spectra<'_> {
    /// Check the lengths.
    ///
    /// # Errors
    /// [`crate::error::Error::Invalid`] if a length is wrong.
    pub fn require(&self, late: &[Late<'_>]) -> Result<()> {
        let rows = ORDERS * 2 * self.count;
        require(self.count.is_multiple_of(BLOCK) && self.count > 0, || {
            format!("signals: found {} frequencies, expected a multiple of {BLOCK}", self.count)
        })?;
        require(self.values.len() == super::SIGNALS.len() * rows, || {
            format!("signals: found {} numbers, expected {}", self.values.len(), super::SIGNALS.len() * rows)
        })?;
        for one in late {
            require(one.values.len() == rows && one.rest.is_finite(), || {
                format!(
                    "late signals: found {} numbers, rest {}, expected {rows}",
                    one.values.len(),
                    one.rest
                )
            })?;
        }
        require(self.spacing > 0.0 && self.spacing.is_finite(), || {
            format!("spacing: found {}, expected more than 0", self.spacing)
        })
    }
}

/// Bytes of a cache line.
const LINE: usize = 64;

/// Numbers aligned to cache lines: a SIMD vector that crosses a line takes twice as long to load.
pub struct Aligned {
    values: Vec<f64>,
    start: usize,
    length: usize,
}

impl Aligned {
    /// Zeros.
    pub fn new(length: usize) -> Self {
        let spare = LINE / size_of::<f64>();
        let values = vec![0.0; length + spare];
        let start = values.as_ptr().align_offset(LINE).min(spare);
        Self { values, start, length }
    }

    #[inline(always)]
    pub fn get(&self) -> &[f64] {
        &self.values[self.start..self.start + self.length]
    }

    #[inline(always)]
    pub fn get_mut(&mut self) -> &mut [f64] {
        &mut self.values[self.start..self.start + self.length]
    }
}

/// Columns in a tile. The matrix of products of all columns is computed in square blocks, each the products between two
/// tiles of columns.
pub const TILE: usize = 3;

/// Number of columns of residual and derivatives, padded to whole tiles.
pub fn padded(equations: &Equations) -> usize {
    match equations.slopes.len() {
        0 => 1,
        slopes => (1 + slopes).next_multiple_of(TILE),
    }
}

/// A coefficient, and the index of its factor, s^k times a signal.
#[derive(Debug, Clone, Copy)]
pub struct Item {
    pub slot: usize,
    pub factor: f64,
}

/// Constants of all blocks. Loops over frequencies have no closures, which would be compiled separately, without vector
/// instructions.
pub struct Plan<'a, const O: usize> {
    pub q: &'a [f64; COUNT],
    pub spectra: Spectra<'a>,
    pub late: &'a [Late<'a>],
    /// Number of powers of s of each signal, and index of the first.
    pub lengths: [usize; signal::COUNT],
    pub slots: [usize; signal::COUNT],
    /// Number of all powers of signals.
    pub size: usize,
    /// Terms by column, residual first, and equation.
    pub items: Vec<[Vec<Item>; O]>,
    /// Measured outputs, and the caller's index of each.
    pub outputs: [usize; O],
    pub places: [usize; O],
    /// Coefficients of each equation for each output, and for the delayed speed and torque.
    pub near: [[[f64; DEGREES]; O]; O],
    pub fed: [[[f64; DEGREES]; 2]; O],
    pub apart: f64,
}

impl<'a, const O: usize> Plan<'a, O> {
    pub fn new(equations: &'a Equations, spectra: Spectra<'a>, late: &'a [Late<'a>]) -> Self {
        let mut lengths = [0; signal::COUNT];
        for term in equations.every() {
            lengths[term.signal] = lengths[term.signal].max(term.length);
        }
        let (mut slots, mut size) = ([0; signal::COUNT], 0);
        for (slot, length) in slots.iter_mut().zip(lengths) {
            *slot = size;
            size += length;
        }
        let columns = [&equations.terms].into_iter().chain(equations.slopes.iter().map(|(_, terms)| terms));
        let items = columns
            .map(|terms| {
                let mut found: [Vec<Item>; O] = std::array::from_fn(|_| vec![]);
                for term in terms {
                    let all = (slots[term.signal]..).zip(term.coefficients);
                    let items = all.filter(|(_, factor)| *factor != 0.0);
                    found[term.equation].extend(items.map(|(slot, factor)| Item { slot, factor }));
                }
                found
            })
            .collect();
        let mut order: Vec<(usize, usize)> =
            equations.outputs.iter().enumerate().map(|(place, &output)| (output, place)).collect();
        order.sort_unstable();
        let outputs: [usize; O] = std::array::from_fn(|index| order[index].0);
        let (mut near, mut fed) = ([[[0.0; DEGREES]; O]; O], [[[0.0; DEGREES]; 2]; O]);
        for term in &equations.terms {
            if term.signal == signal::LATE_N {
                fed[term.equation][0] = term.coefficients;
            } else if term.signal == signal::LATE_M {
                fed[term.equation][1] = term.coefficients;
            } else if let Some(column) = outputs.iter().position(|&output| SHOWN[output] == term.signal) {
                near[term.equation][column] = term.coefficients;
            }
        }
        Self {
            q: &equations.values,
            spectra,
            late,
            lengths,
            slots,
            size,
            items,
            outputs,
            places: std::array::from_fn(|index| order[index].1),
            near,
            fed,
            apart: equations.apart(),
        }
    }
}

/// Signal of each output.
pub const SHOWN: [usize; MOST] = [signal::N, signal::M, signal::X, signal::M_B];

/// Store numbers of a block as real and imaginary parts.
#[inline(always)]
pub fn store<S: Simd>(value: Complex<S>, block: &mut [f64], number: usize, inner: usize) {
    let both = S::as_mut_simd_f64s(&mut block[number * 2 * BLOCK..(number + 1) * 2 * BLOCK]).0;
    both[inner] = value.re;
    both[inner + BLOCK / S::F64_LANES] = value.im;
}

#[inline(always)]
pub fn load<S: Simd>(_: S, block: &[f64], number: usize, inner: usize) -> Complex<S> {
    let both = S::as_simd_f64s(&block[number * 2 * BLOCK..(number + 1) * 2 * BLOCK]).0;
    Complex { re: both[inner], im: both[inner + BLOCK / S::F64_LANES] }
}
