//! Bindings of a ship's two equations.

use numpy::{Ix3, Ix4, PyArray2, PyArray4, PyReadonlyArray, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use super::arrays::{Matrix, Vector, borrow, hand_back};
use super::guard;
use crate::error::{Error, require};
use crate::two_equations::{
    BLOCK, Equations, Late, Noise, ORDERS, OUTPUTS, PARAMETERS, SIGNALS, Setup, Spectra, is_stable, products,
    residuals,
};

/// Number of state updates that take as long as one column at one frequency.
const COLUMN: usize = 4;

type Signals<'py> = PyReadonlyArray<'py, f64, Ix4>;
type Orders<'py> = PyReadonlyArray<'py, f64, Ix3>;

fn expect(name: &str, found: &[usize], expected: &[usize]) -> PyResult<()> {
    Ok(require(found == expected, || {
        format!("{name}: found an array of shape {found:?}, expected {expected:?}")
    })?)
}

/// Borrowed arguments for one record; both kernels take the same ones.
struct Record<'py> {
    equations: Equations,
    signals: Signals<'py>,
    late: Vec<(Orders<'py>, f64)>,
    spacing: f64,
    open_loop: bool,
}

/// Names of the delayed signals.
const LATE: [&str; 3] = ["late speed", "late set point", "late torque"];

impl<'py> Record<'py> {
    // long: every argument is checked where it is borrowed
    #[allow(clippy::too_many_arguments)]
    fn borrow(
        parameters: &Bound<'py, PyAny>,
        signals: &Bound<'py, PyAny>,
        spacing: f64,
        late: &[(Bound<'py, PyAny>, f64)],
        outputs: &[usize],
        gauge: bool,
        open_loop: bool,
        wrt: &[usize],
    ) -> PyResult<Self> {
        let parameters: Vector<'_> = borrow("parameters", parameters)?;
        let signals: Signals<'_> = borrow("signals", signals)?;
        let count = signals.shape()[3];
        expect("signals", signals.shape(), &[SIGNALS.len(), ORDERS, 2, count])?;
        require(matches!(late.len(), 2 | 3), || {
            format!(
                "late: found {} signals, expected speed and set point, or these and the torque",
                late.len()
            )
        })?;
        let late = late.iter().zip(LATE).map(|((orders, rest), name)| {
            let orders: Orders<'_> = borrow(name, orders)?;
            expect(name, orders.shape(), &[ORDERS, 2, count])?;
            Ok((orders, *rest))
        });
        let late = late.collect::<PyResult<Vec<_>>>()?;
        let setup = Setup { gauge, open_loop, propeller: late.len() == 3 };
        let equations = Equations::new(parameters.as_slice()?, outputs, setup, wrt)?;
        Ok(Self { equations, signals, late, spacing, open_loop })
    }

    fn spectra(&self) -> PyResult<Spectra<'_>> {
        let count = self.signals.shape()[3];
        Ok(Spectra { values: self.signals.as_slice()?, count, spacing: self.spacing })
    }

    fn late(&self) -> PyResult<Vec<Late<'_>>> {
        self.late.iter().map(|(orders, rest)| Ok(Late { values: orders.as_slice()?, rest: *rest })).collect()
    }
}

/// Array [1 + W, O, 2, F]: the residuals at index 0, then the model's derivatives by the parameters of index `wrt`.
#[pyfunction]
#[allow(clippy::too_many_arguments, clippy::needless_pass_by_value)]
fn equation_residuals<'py>(
    py: Python<'py>,
    parameters: &Bound<'py, PyAny>,
    signals: &Bound<'py, PyAny>,
    spacing: f64,
    late: Vec<(Bound<'py, PyAny>, f64)>,
    outputs: Vec<usize>,
    gauge: bool,
    open_loop: bool,
    wrt: Vec<usize>,
) -> PyResult<Bound<'py, PyArray4<f64>>> {
    let record = Record::borrow(parameters, signals, spacing, &late, &outputs, gauge, open_loop, &wrt)?;
    let (equations, spectra, late) = (&record.equations, record.spectra()?, record.late()?);
    let (columns, count) = (1 + wrt.len(), spectra.count);
    let values = guard::run(py, columns * count * COLUMN, |stop| residuals(equations, spectra, &late, stop))?;
    hand_back(py, values, [columns, outputs.len(), 2, count])
}

type Products<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>);

/// Products in units of the noise: between residual and derivatives [1 + W, 1 + W], and between the systematic errors and
/// residual and derivatives [2 O K, 1 + W].
#[pyfunction]
#[allow(clippy::too_many_arguments, clippy::needless_pass_by_value)]
fn equation_products<'py>(
    py: Python<'py>,
    parameters: &Bound<'py, PyAny>,
    signals: &Bound<'py, PyAny>,
    spacing: f64,
    late: Vec<(Bound<'py, PyAny>, f64)>,
    outputs: Vec<usize>,
    gauge: bool,
    open_loop: bool,
    wrt: Vec<usize>,
    root: &Bound<'py, PyAny>,
    shapes: &Bound<'py, PyAny>,
    hats: &Bound<'py, PyAny>,
) -> PyResult<Products<'py>> {
    let record = Record::borrow(parameters, signals, spacing, &late, &outputs, gauge, open_loop, &wrt)?;
    let (equations, spectra, late) = (&record.equations, record.spectra()?, record.late()?);
    let (root, shapes): (Signals<'_>, Signals<'_>) = (borrow("root", root)?, borrow("shapes", shapes)?);
    let hats: Matrix<'_> = borrow("hats", hats)?;
    let (count, number) = (spectra.count, outputs.len());
    expect("root", root.shape(), &[number, number, 2, count])?;
    if !shapes.is_empty() {
        expect("shapes", shapes.shape(), &[number, number, 2, count])?;
    }
    expect("hats", hats.shape(), &[hats.shape()[0], count])?;
    if !is_stable(&equations.values, record.open_loop) {
        return Err(Error::Unstable.into());
    }
    let noise = Noise { root: root.as_slice()?, shapes: shapes.as_slice()?, hats: hats.as_slice()? };
    let columns = 1 + wrt.len();
    let found =
        guard::run(py, columns * count * COLUMN, |stop| products(equations, spectra, &late, noise, stop))?;
    let errors = found.errors.len() / columns;
    Ok((hand_back(py, found.gram, [columns, columns])?, hand_back(py, found.errors, [errors, columns])?))
}

/// Whether the loop of a ship is stable about its operating point.
#[pyfunction]
fn loop_is_stable(parameters: &Bound<'_, PyAny>, open_loop: bool) -> PyResult<bool> {
    let parameters: Vector<'_> = borrow("parameters", parameters)?;
    let equations = Equations::new(parameters.as_slice()?, &[0, 1], Setup::default(), &[])?;
    Ok(is_stable(&equations.values, open_loop))
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("EQUATION_PARAMETERS", PyTuple::new(module.py(), PARAMETERS)?)?;
    module.add("EQUATION_SIGNALS", PyTuple::new(module.py(), SIGNALS)?)?;
    module.add("EQUATION_OUTPUTS", PyTuple::new(module.py(), OUTPUTS)?)?;
    module.add("EQUATION_ORDERS", ORDERS)?;
    module.add("EQUATION_BLOCK", BLOCK)?;
    module.add_function(wrap_pyfunction!(equation_residuals, module)?)?;
    module.add_function(wrap_pyfunction!(equation_products, module)?)?;
    module.add_function(wrap_pyfunction!(loop_is_stable, module)?)?;
    Ok(())
}
