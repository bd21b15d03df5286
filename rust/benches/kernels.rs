//! Times of the kernels without Python: `cargo bench`.
#![allow(missing_docs)]

use std::hint::black_box;
use std::time::Duration;

use _core::error::Error;
use _core::filter::{Decimator, running_median};
use _core::hold::Hold;
use _core::power::power;
use _core::pulse::PulseCrossings;
use _core::statespace::Recursion;
use _core::stepper::{self, parameters::at};
use _core::stop::Stop;
use _core::two_equations::{Equations, Late, Noise, PARAMETERS, Setup, Spectra, products};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};

const SAMPLES: usize = 10_000;

/// A set point that wanders about `middle`.
fn wander(middle: f64, samples: usize) -> Vec<f64> {
    (0..samples).map(|k| middle * (1.0 + 0.05 * (k as f64 * 0.013).sin())).collect()
}

/// Stan Tug 1205 with all its elements, divided by its operating point: by [`stepper::DETAIL`].
const TUG: [f64; 18] =
    [0.05, 0.5, 1.0, 4.59, 0.333, 0.5, 19.73, 1.0, 0.0099, 1.0, 0.99, 5.165, 3.0, 0.005, 0.01, 0.0, 0.0, 0.0];

fn powers(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("powers of 1000 numbers");
    let speeds: Vec<f64> = (0..1000).map(|k| f64::from(k) * 0.37).collect();
    // Each waits for the one before, as in a simulation.
    let sum =
        |function: fn(f64) -> f64| speeds.iter().fold(0.0, |before, &speed| function(speed + 1e-12 * before));
    group.bench_function("library", |b| b.iter(|| sum(|speed| speed.powf(black_box(2.17)))));
    group.bench_function("ours", |b| b.iter(|| sum(|speed| power(speed, black_box(2.17)))));
    group.finish();
}

fn recursion(criterion: &mut Criterion) -> Result<(), Error> {
    let mut group = criterion.benchmark_group("linear recursion, a sample");
    let signal = wander(0.01, SAMPLES);
    for (states, directions) in [(2, 0), (2, 7), (8, 0), (8, 7)] {
        let shifts = [0, 1];
        let size = (1 + directions) * (states + 2) * (states + shifts.len());
        // Every state half of itself, a tenth of the next.
        let system: Vec<_> = (0..size).map(|at| [0.5, 0.1, 0.0][(at % (states + 3)).min(2)]).collect();
        let start = vec![0.0; (1 + directions) * states];
        let recursion = Recursion::new(&system, &start, [states, 2], &signal, &shifts, 0.01)?;
        let mut values = vec![0.0; 2 * SAMPLES];
        let mut slopes = vec![0.0; directions * values.len()];
        group.throughput(Throughput::Elements(SAMPLES as u64));
        group.bench_function(format!("{states} states, {directions} derivatives"), |bencher| {
            bencher.iter(|| black_box(&recursion).run(&mut values, &mut slopes, &Stop::new()));
        });
    }
    group.finish();
    Ok(())
}

fn ship(criterion: &mut Criterion) -> Result<(), Error> {
    let mut group = criterion.benchmark_group("ship, a step");
    let set = wander(1.0, SAMPLES);
    let run = stepper::Run::new(&set, &[], 0.02, 4, Hold::First)?;
    let mut vector = stepper::OFF;
    let told = [
        (at::TAU_N, 1.5),
        (at::G, -0.583),
        (at::V, 1.0),
        (at::K_P, 6.33),
        (at::K_I, 1.583),
        (at::P, 2.17),
        (at::TAU_PROP, 0.6),
        (at::T_D, 0.1213),
        (at::T_SET, 0.0351),
        (at::TAU_ACT, 0.06),
    ];
    for (place, value) in told {
        vector[place] = value;
    }
    let parameters = stepper::Parameters::new(&vector, "parameters")?;
    let outputs = stepper::Output::from_indices(&[0, 2])?;
    group.throughput(Throughput::Elements(4 * SAMPLES as u64));
    let mut rows = vec![0.0; SAMPLES * outputs.len()];
    group.bench_function("both dead times and a lag", |bencher| {
        bencher.iter(|| stepper::simulate(black_box(&parameters), &run, &outputs, &mut rows, &Stop::new()));
    });
    let detail = stepper::Detail::new(&TUG, &[1.04, 0.98, 0.98, 1.04, 0.98, 0.98], None)?;
    let whole = stepper::Run { detail: Some(&detail), ..run };
    let told = [(at::T_S, 0.0169), (at::TAU_TWIST, 0.00018), (at::ZETA_TWIST, 4.6), (at::RATE_UP, 10.0)];
    let mut tug = vector;
    for (place, value) in told {
        tug[place] = value;
    }
    let parameters = stepper::Parameters::new(&tug, "parameters")?;
    group.bench_function("the tug with all its elements", |bencher| {
        bencher.iter(|| stepper::simulate(black_box(&parameters), &whole, &outputs, &mut rows, &Stop::new()));
    });
    group.throughput(Throughput::Elements(SAMPLES as u64));
    for place in [at::T_D, at::T_SET, at::TAU_ACT] {
        vector[place] = stepper::OFF[place];
    }
    let plain = stepper::Parameters::new(&vector, "parameters")?;
    let run = stepper::Run::new(&set, &[], 0.01, 1, Hold::Zero)?;
    let (method, start) = (stepper::Method::Rk4, [1.0, 0.0]);
    group.bench_function("by RK4", |bencher| {
        bencher.iter(|| {
            let plain = black_box(&plain);
            stepper::simulate_explicitly(plain, &run, method, &start, &outputs, &mut rows, &Stop::new())
        });
    });
    group.finish();
    Ok(())
}

fn signals(criterion: &mut Criterion) -> Result<(), Error> {
    let mut group = criterion.benchmark_group("signals, a sample");
    group.throughput(Throughput::Elements(100 * SAMPLES as u64));
    let train: Vec<f32> =
        (0..100 * SAMPLES).map(|k| if (k as f32 * 0.05).sin() > 0.0 { 4.0 } else { 0.0 }).collect();
    let mut crossings = PulseCrossings::new(1.0, 3.0, 2.0)?;
    group.bench_function("crossings of a pulse train", |bencher| {
        bencher.iter(|| crossings.feed(black_box(&train), &Stop::new()));
    });
    group.throughput(Throughput::Elements(SAMPLES as u64));
    let wave = wander(1.0, SAMPLES);
    let mut decimator = Decimator::new(&[1.0 / 101.0; 101], 1, 10)?;
    group.bench_function("low-pass of 101 taps, every tenth", |bencher| {
        bencher.iter(|| decimator.feed(black_box(&wave), &Stop::new()));
    });
    group.bench_function("running median of 101", |bencher| {
        bencher.iter(|| running_median(black_box(&wave), 101, &Stop::new()));
    });
    group.finish();
    Ok(())
}

fn equations(criterion: &mut Criterion) -> Result<(), Error> {
    const COUNT: usize = 2016;
    let mut group = criterion.benchmark_group("two equations, 2016 frequencies");
    let values = wander(0.1, 7 * 8 * COUNT);
    let spectra = Spectra { values: &values, count: COUNT, spacing: 0.01 };
    let late = |rest| Late { values: &values[..8 * COUNT], rest };
    let (square, hats) = (wander(1.0, 8 * COUNT), wander(1.0, 2 * COUNT));
    let noise = Noise { root: &square, shapes: &square, hats: &hats };
    let mut vector = [0.0; PARAMETERS.len()];
    for (place, value) in [(0, 1.5), (1, -0.6), (2, 6.3), (3, 1.6), (5, 2.17), (6, 0.6), (9, 0.3), (10, 0.12)]
    {
        vector[place] = value;
    }
    for (place, value) in
        [(11, 0.035), (13, 0.06), (14, 0.03), (15, 0.02), (18, 1.0), (19, 0.002), (20, 1.03)]
    {
        vector[place] = value;
    }
    let all = [0, 1, 2, 3, 5, 6, 7, 8, 9, 10, 11, 13, 14, 15, 19, 20, 21];
    for (name, wrt) in [("products of residuals", &all[..0]), ("with seventeen derivatives", &all[..])] {
        Equations::new(&vector, &[0, 1], Setup::default(), wrt)?;
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                let equations = Equations::new(black_box(&vector), &[0, 1], Setup::default(), wrt)?;
                products(&equations, spectra, &[late(0.02), late(0.005)], noise, &Stop::new())
            });
        });
    }
    group.finish();
    Ok(())
}

fn all(criterion: &mut Criterion) {
    powers(criterion);
    for bench in [ship, recursion, signals, equations] {
        bench(criterion).expect("inputs as the kernels want them");
    }
}

criterion_group! {
    name = kernels;
    config = Criterion::default().sample_size(20).warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(1));
    targets = all
}
criterion_main!(kernels);
