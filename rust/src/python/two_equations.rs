//! Bindings of a ship's two equations.

use numpy::{Ix3, Ix4, PyArray2, PyArray4, PyReadonlyArray, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use super::arrays::{Matrix, Vector, borrow, hand_back};
use super::guard;
use crate::error::{Error, require};
use crate::two_equations::{
    BLOCK, Equations, Late, Noise, ORDERS, OUTPUTS, PARAMETERS, SIGNALS, Spectra, is_stable, products,
    residuals,
};

/// State updates that a column at one frequency is worth, in time.
const COLUMN: usize = 4;

type Signals<'py> = PyReadonlyArray<'py, f64, Ix4>;
type Orders<'py> = PyReadonlyArray<'py, f64, Ix3>;

fn expect(name: &str, found: &[usize], expected: &[usize]) -> PyResult<()> {
    Ok(require(found == expected, || {
        format!("{name}: found an array of shape {found:?}, expected {expected:?}")
    })?)
}

/// Residuals [0] and the model's derivatives by the parameters of index `wrt`, [1 + W, O, 2, F].
#[pyfunction]
#[allow(clippy::too_many_arguments)]
fn equation_residuals<'py>(
    py: Python<'py>,
    parameters: &Bound<'py, PyAny>,
    signals: &Bound<'py, PyAny>,
    spacing: f64,
    late_speed: &Bound<'py, PyAny>,
    speed_rest: f64,
    late_set_point: &Bound<'py, PyAny>,
    set_point_rest: f64,
    outputs: Vec<usize>,
    gauge: bool,
    open_loop: bool,
    wrt: Vec<usize>,
) -> PyResult<Bound<'py, PyArray4<f64>>> {
    let parameters: Vector<'_> = borrow("parameters", parameters)?;
    let signals: Signals<'_> = borrow("signals", signals)?;
    let (speed, set_point): (Orders<'_>, Orders<'_>) =
        (borrow("late_speed", late_speed)?, borrow("late_set_point", late_set_point)?);
    let count = signals.shape()[3];
    expect("signals", signals.shape(), &[SIGNALS.len(), ORDERS, 2, count])?;
    expect("late_speed", speed.shape(), &[ORDERS, 2, count])?;
    expect("late_set_point", set_point.shape(), &[ORDERS, 2, count])?;
    let equations = Equations::new(parameters.as_slice()?, &outputs, gauge, open_loop, &wrt)?;
    let spectra = Spectra { values: signals.as_slice()?, count, spacing };
    let late = [
        Late { values: speed.as_slice()?, rest: speed_rest },
        Late { values: set_point.as_slice()?, rest: set_point_rest },
    ];
    let work = (1 + wrt.len()) * count * COLUMN;
    let values = guard::run(py, work, |stop| residuals(&equations, spectra, late[0], late[1], stop))?;
    hand_back(py, values, [1 + wrt.len(), outputs.len(), 2, count])
}

type Products<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>);

/// Products in units of the noise: of residual and derivatives [1 + W, 1 + W], and of the smooth errors with them [2 O K, 1 + W].
#[pyfunction]
#[allow(clippy::too_many_arguments)]
fn equation_products<'py>(
    py: Python<'py>,
    parameters: &Bound<'py, PyAny>,
    signals: &Bound<'py, PyAny>,
    spacing: f64,
    late_speed: &Bound<'py, PyAny>,
    speed_rest: f64,
    late_set_point: &Bound<'py, PyAny>,
    set_point_rest: f64,
    outputs: Vec<usize>,
    gauge: bool,
    open_loop: bool,
    wrt: Vec<usize>,
    root: &Bound<'py, PyAny>,
    shapes: &Bound<'py, PyAny>,
    hats: &Bound<'py, PyAny>,
) -> PyResult<Products<'py>> {
    let parameters: Vector<'_> = borrow("parameters", parameters)?;
    let signals: Signals<'_> = borrow("signals", signals)?;
    let (speed, set_point): (Orders<'_>, Orders<'_>) =
        (borrow("late_speed", late_speed)?, borrow("late_set_point", late_set_point)?);
    let (root, shapes): (Signals<'_>, Signals<'_>) = (borrow("root", root)?, borrow("shapes", shapes)?);
    let hats: Matrix<'_> = borrow("hats", hats)?;
    let (count, number) = (signals.shape()[3], outputs.len());
    expect("signals", signals.shape(), &[SIGNALS.len(), ORDERS, 2, count])?;
    expect("late_speed", speed.shape(), &[ORDERS, 2, count])?;
    expect("late_set_point", set_point.shape(), &[ORDERS, 2, count])?;
    let equations = Equations::new(parameters.as_slice()?, &outputs, gauge, open_loop, &wrt)?;
    expect("root", root.shape(), &[number, number, 2, count])?;
    if !shapes.is_empty() {
        expect("shapes", shapes.shape(), &[number, number, 2, count])?;
    }
    expect("hats", hats.shape(), &[hats.shape()[0], count])?;
    if !is_stable(&equations.values, open_loop) {
        return Err(Error::Unstable.into());
    }
    let spectra = Spectra { values: signals.as_slice()?, count, spacing };
    let late = [
        Late { values: speed.as_slice()?, rest: speed_rest },
        Late { values: set_point.as_slice()?, rest: set_point_rest },
    ];
    let noise = Noise { root: root.as_slice()?, shapes: shapes.as_slice()?, hats: hats.as_slice()? };
    let columns = 1 + wrt.len();
    let found = guard::run(py, columns * count * COLUMN, |stop| {
        products(&equations, spectra, late[0], late[1], noise, stop)
    })?;
    let errors = found.errors.len() / columns;
    Ok((hand_back(py, found.gram, [columns, columns])?, hand_back(py, found.errors, [errors, columns])?))
}

/// Whether the loop of a rigid ship is stable about its operating point.
#[pyfunction]
fn loop_is_stable(parameters: &Bound<'_, PyAny>, open_loop: bool) -> PyResult<bool> {
    let parameters: Vector<'_> = borrow("parameters", parameters)?;
    let equations = Equations::new(parameters.as_slice()?, &[0, 1], false, open_loop, &[])?;
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
