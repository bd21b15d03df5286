//! Powers of s times the signals of the equations, delayed and tapered.

use pulp::Simd;

use super::complex::{Complex, Rotation, negative};
use super::equations::{DEGREES, ORDERS, at, signal};
use super::plan::{Plan, store};

/// Rotations for the delays of a record.
pub struct Turns<S: Simd> {
    pub speed: Rotation<S>,
    pub torque: Rotation<S>,
    /// Rotation of the brake's torque measured besides a gauge's.
    pub brake: Rotation<S>,
    /// Rotations of the delayed speed, set point and torque.
    pub late: [Rotation<S>; 3],
    pub dead: Rotation<S>,
    pub apart: Rotation<S>,
}

impl<S: Simd> Turns<S> {
    #[inline(always)]
    pub fn new<const O: usize>(simd: S, plan: &Plan<'_, O>) -> Self {
        let (q, spacing) = (plan.q, plan.spectra.spacing);
        Self {
            speed: Rotation::new(simd, spacing, -q[at::T_N]),
            torque: Rotation::new(simd, spacing, -q[at::T_M]),
            brake: Rotation::new(simd, spacing, -q[at::T_B]),
            late: [
                Rotation::new(simd, spacing, plan.late[0].rest - q[at::T_N]),
                Rotation::new(simd, spacing, plan.late[1].rest),
                Rotation::new(simd, spacing, plan.late.last().map_or(0.0, |late| late.rest) - q[at::T_M]),
            ],
            dead: Rotation::new(simd, spacing, q[at::T_D]),
            apart: Rotation::new(simd, spacing, plan.apart),
        }
    }

    #[inline(always)]
    pub fn advance(&mut self, simd: S) {
        self.speed.advance(simd);
        self.torque.advance(simd);
        self.brake.advance(simd);
        for late in &mut self.late {
            late.advance(simd);
        }
        self.dead.advance(simd);
        self.apart.advance(simd);
    }

    /// cos and sin of half the distance between a hold's two commands.
    #[inline(always)]
    pub fn hold(&self, simd: S) -> [S::f64s; 2] {
        [self.apart.now.re, negative(simd, self.apart.now.im)]
    }
}

/// The first orders of a signal at some frequencies.
#[inline(always)]
fn read<S: Simd>(simd: S, values: &[f64], count: usize, orders: usize, place: usize) -> [Complex<S>; ORDERS] {
    let mut found = [Complex::zero(simd); ORDERS];
    for order in 0..ORDERS {
        if order < orders {
            let start = 2 * order * count;
            found[order] = Complex {
                re: S::as_simd_f64s(&values[start..start + count]).0[place],
                im: S::as_simd_f64s(&values[start + count..start + 2 * count]).0[place],
            };
        }
    }
    found
}

/// Powers of s times all signals of the equations.
#[inline(always)]
pub fn lay_out<S: Simd, const O: usize>(
    simd: S,
    plan: &Plan<'_, O>,
    turns: &Turns<S>,
    omega: S::f64s,
    place: usize,
    powers: &mut [f64],
    inner: usize,
) {
    let (q, count, lengths) = (plan.q, plan.spectra.count, &plan.lengths);
    let (size, values) = (ORDERS * 2 * count, plan.spectra.values);
    let late = q[at::T_N];
    for known in [signal::X, signal::LOAD, signal::ONE, signal::N, signal::N2, signal::N3] {
        if lengths[known] == 0 {
            continue;
        }
        let is_late = late != 0.0 && matches!(known, signal::N | signal::N2 | signal::N3);
        let needed = if is_late { ORDERS } else { lengths[known] };
        let mut orders = read(simd, &values[known * size..], count, needed, place);
        if is_late {
            orders = delayed(simd, orders, turns.speed.now, -late);
        }
        raise(simd, plan, omega, orders, known, powers, inner);
    }
    let one = read(simd, &values[signal::ONE * size..], count, ORDERS, place);
    // The torque is (M + 1) / s_M - 1 + m_0, whose constants are not delayed.
    let scale = 1.0 / q[at::S_M];
    let (scale, rest) = (simd.splat_f64s(scale), simd.splat_f64s(scale - 1.0 + q[at::M_0]));
    let by_brake = 1.0 / q[at::S_B];
    let torques = [
        (signal::M, q[at::T_M], turns.torque.now, scale, rest),
        (
            signal::M_B,
            q[at::T_B],
            turns.brake.now,
            simd.splat_f64s(by_brake),
            simd.splat_f64s(by_brake - 1.0),
        ),
    ];
    for (known, late, turn, scale, rest) in torques {
        if lengths[known] == 0 {
            continue;
        }
        let mut orders = read(simd, &values[known * size..], count, ORDERS, place);
        if late != 0.0 {
            orders = delayed(simd, orders, turn, -late);
        }
        raise(simd, plan, omega, shifted(simd, orders, scale, one, rest), known, powers, inner);
    }
    lay_out_late(simd, plan, turns, omega, place, [scale, rest], powers, inner);
}

/// Prepare the signals that reach the governor with delay; the torque has a scale and an offset.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn lay_out_late<S: Simd, const O: usize>(
    simd: S,
    plan: &Plan<'_, O>,
    turns: &Turns<S>,
    omega: S::f64s,
    place: usize,
    [scale, rest]: [S::f64s; 2],
    powers: &mut [f64],
    inner: usize,
) {
    let (q, count, lengths) = (plan.q, plan.spectra.count, &plan.lengths);
    let values = plan.spectra.values;
    let one = read(simd, &values[signal::ONE * ORDERS * 2 * count..], count, ORDERS, place);
    let places = [
        (0, signal::LATE_N, signal::APART_N, q[at::T_N]),
        (1, signal::LATE_U, signal::APART_U, 0.0),
        (2, signal::LATE_M, signal::APART_M, q[at::T_M]),
    ];
    for (index, known, beside, own) in places {
        if lengths[known] == 0 {
            continue;
        }
        let orders = read(simd, plan.late[index].values, count, ORDERS, place);
        let mut near = delayed(simd, orders, turns.late[index].now, plan.late[index].rest - own);
        if plan.apart != 0.0 {
            let mut far;
            (near, far) = parted(simd, near, turns.hold(simd), plan.apart);
            if lengths[beside] > 0 {
                if known == signal::LATE_M {
                    for order in &mut far {
                        *order = order.scaled(simd, scale);
                    }
                }
                raise(simd, plan, omega, far, beside, powers, inner);
            }
        }
        match known {
            signal::LATE_U => {
                near = shifted(simd, near, simd.splat_f64s(1.0), one, simd.splat_f64s(q[at::U_0]));
            }
            signal::LATE_M => near = shifted(simd, near, scale, one, rest),
            _ => {}
        }
        raise(simd, plan, omega, near, known, powers, inner);
    }
}

/// A signal times a scale, plus a constant without delay.
#[inline(always)]
fn shifted<S: Simd>(
    simd: S,
    mut orders: [Complex<S>; ORDERS],
    scale: S::f64s,
    one: [Complex<S>; ORDERS],
    by: S::f64s,
) -> [Complex<S>; ORDERS] {
    for order in 0..ORDERS {
        orders[order] = orders[order].scaled(simd, scale).plus_scaled(simd, one[order], by);
    }
    orders
}

/// s^k times a signal, for all k below its length.
#[inline(always)]
fn raise<S: Simd, const O: usize>(
    simd: S,
    plan: &Plan<'_, O>,
    omega: S::f64s,
    orders: [Complex<S>; ORDERS],
    known: usize,
    powers: &mut [f64],
    inner: usize,
) {
    let slot = plan.slots[known];
    match plan.lengths[known] {
        1 => raised::<S, 1>(simd, omega, orders, slot, powers, inner),
        2 => raised::<S, 2>(simd, omega, orders, slot, powers, inner),
        3 => raised::<S, 3>(simd, omega, orders, slot, powers, inner),
        4 => raised::<S, 4>(simd, omega, orders, slot, powers, inner),
        5 => raised::<S, 5>(simd, omega, orders, slot, powers, inner),
        6 => raised::<S, 6>(simd, omega, orders, slot, powers, inner),
        7 => raised::<S, 7>(simd, omega, orders, slot, powers, inner),
        _ => raised::<S, DEGREES>(simd, omega, orders, slot, powers, inner),
    }
}

#[inline(always)]
fn raised<S: Simd, const LENGTH: usize>(
    simd: S,
    omega: S::f64s,
    mut orders: [Complex<S>; ORDERS],
    slot: usize,
    powers: &mut [f64],
    inner: usize,
) {
    let zero = Complex::zero(simd);
    store(orders[0], powers, slot, inner);
    for power in 1..LENGTH {
        for order in 0..ORDERS.min(LENGTH - power) {
            let next = if order + 1 < ORDERS { orders[order + 1] } else { zero };
            orders[order] = orders[order].risen(simd, omega, next);
        }
        store(orders[0], powers, slot + power, inner);
    }
}

/// Spectra of a delayed signal with the taper and its derivatives (`orders`), for a delay t and `turn` = exp(-s t).
#[inline(always)]
fn delayed<S: Simd>(simd: S, orders: [Complex<S>; ORDERS], turn: Complex<S>, t: f64) -> [Complex<S>; ORDERS] {
    let steps = [1.0, -t, 0.5 * t * t, -t * t * t / 6.0];
    let mut found = orders;
    for k in 0..ORDERS {
        let mut sum = orders[k];
        for j in 1..ORDERS - k {
            sum = sum.plus_scaled(simd, orders[k + j], simd.splat_f64s(steps[j]));
        }
        found[k] = sum.times(simd, turn);
    }
    found
}

/// cosh(s t) and sinh(s t) times a signal, s = j omega: mean of two commands 2 t apart, and half their difference.
#[inline(always)]
fn parted<S: Simd>(
    simd: S,
    orders: [Complex<S>; ORDERS],
    [cosine, sine]: [S::f64s; 2],
    t: f64,
) -> ([Complex<S>; ORDERS], [Complex<S>; ORDERS]) {
    let steps = [1.0, t, 0.5 * t * t, t * t * t / 6.0];
    let zero = Complex::zero(simd);
    let mut found = [[zero; ORDERS]; 2];
    for k in 0..ORDERS {
        for j in 0..ORDERS - k {
            let value = orders[k + j].scaled(simd, simd.splat_f64s(steps[j]));
            let turned = Complex { re: negative(simd, value.im), im: value.re };
            let (even, odd) = (value.scaled(simd, cosine), turned.scaled(simd, sine));
            let (first, second) = if j % 2 == 0 { (even, odd) } else { (odd, even) };
            found[0][k] = found[0][k].plus(simd, first);
            found[1][k] = found[1][k].plus(simd, second);
        }
    }
    (found[0], found[1])
}
