//! Times of the kernels without Python: `cargo bench`.
#![allow(missing_docs)]

use std::f64::consts::TAU;
use std::hint::black_box;
use std::time::Duration;

use _core::cost::Record;
use _core::drive_train::{self, DriveTrain, Run, Tables};
use _core::error::Error;
use _core::filter::{Decimator, running_median};
use _core::hold::Hold;
use _core::linear::{By, Drive, Output, Parameters};
use _core::power::power;
use _core::pulse::PulseCrossings;
use _core::stepper::{self, Envelope, parameters::at};
use _core::stop::Stop;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};

/// The virtual launch about its operating point.
const LOOP: [f64; 9] = [1.5, -0.583, 1.583, 4.0, 1.0, 2.0, 1.0, 0.0, 0.0];
const SAMPLES: usize = 10_000;

/// A set point that wanders about `middle`.
fn wander(middle: f64, samples: usize) -> Vec<f64> {
    (0..samples).map(|k| middle * (1.0 + 0.05 * (k as f64 * 0.013).sin())).collect()
}

/// Stan Tug 1205 with all its elements: a governor once a firing, dead times, limits, firing, a shaft that twists.
const TUG: [f64; 45] = [
    62.297,
    3.82,
    0.98,
    55.847,
    -14.153,
    186.158,
    48.915,
    2.17,
    10.0,
    2.2301,
    5.3218,
    f64::NEG_INFINITY,
    22.857,
    81000.0,
    65.0,
    3.3398,
    1.0,
    0.25,
    0.0,
    0.05,
    f64::INFINITY,
    1.0,
    0.0,
    32.0,
    5.0,
    1.0,
    0.07,
    0.03,
    100.0,
    2000.0,
    1.0 / 3.0,
    0.5,
    3.0,
    0.005,
    0.01,
    2.309,
    1.0,
    723.226,
    f64::INFINITY,
    0.0,
    5.16492,
    0.0,
    0.0,
    19.73,
    0.0,
];

fn whole_drive_train(criterion: &mut Criterion) -> Result<(), Error> {
    let mut group = criterion.benchmark_group("its functions, of 1000 numbers");
    let angles: Vec<f64> = (0..1000).map(|k| f64::from(k) * 0.37).collect();
    // Each waits for the one before, as in a simulation.
    let sum =
        |function: fn(f64) -> f64| angles.iter().fold(0.0, |before, &angle| function(angle + 1e-12 * before));
    group.bench_function("cosine, library", |b| b.iter(|| sum(|angle| (TAU * angle).cos())));
    group.bench_function("cosine, ours", |b| b.iter(|| sum(drive_train::cosine)));
    group.bench_function("power, library", |b| b.iter(|| sum(|speed| speed.powf(black_box(2.17)))));
    group.bench_function("power, ours", |b| b.iter(|| sum(|speed| power(speed, black_box(2.17)))));
    group.finish();
    let mut group = criterion.benchmark_group("drive train, RK4, a step");
    let set_speed = wander(19.73, SAMPLES);
    let envelope = Envelope::new(&[10.0, 20.0, 30.0], &[560.0, 1250.0, 1172.0])?;
    let strength = vec![1.04, 0.98, 0.98, 1.04, 0.98, 0.98];
    let train = DriveTrain::from_parameters(&TUG, Tables { strength, quadrants: None })?;
    let run = Run { set_speed: &set_speed, dt: 0.005, substeps: 12, hold: Hold::First };
    let mut output = vec![0.0; drive_train::ROWS * SAMPLES];
    group.throughput(Throughput::Elements((12 * SAMPLES) as u64));
    group.bench_function("the tug with all its elements", |bencher| {
        bencher.iter(|| drive_train::simulate(black_box(&train), &envelope, &run, &mut output, &Stop::new()));
    });
    group.finish();
    Ok(())
}

fn products(criterion: &mut Criterion) -> Result<(), Error> {
    let mut group = criterion.benchmark_group("sums of products, a sample");
    let dn_set = wander(0.01, SAMPLES);
    let measured = vec![0.01; 2 * SAMPLES];
    let outputs = || vec![Output::Speed, Output::EngineTorque];
    let drive = Drive::new(&dn_set, 0.01, Hold::First, &[0.0, 0.0])?;
    let late =
        { LOOP.iter().zip([0.0; 7].iter().chain(&[0.12, 0.035])).map(|(a, b)| a + b).collect::<Vec<_>>() };
    for (name, vector, wrt) in [
        ("one vector", &LOOP[..], vec![]),
        ("derivatives by seven", &LOOP[..], vec![0, 1, 2, 3, 4, 5, 6]),
        ("derivatives by seven, both dead times", &late[..], vec![0, 1, 2, 3, 4, 7, 8]),
    ] {
        let record = Record::new(drive, outputs(), &measured, By::from_indices(&wrt)?)?;
        let parameters = Parameters::new(vector, "parameters")?;
        group.throughput(Throughput::Elements(SAMPLES as u64));
        group.bench_function(name, |bencher| {
            bencher.iter(|| record.products(black_box(&parameters), &Stop::new()));
        });
    }
    group.finish();
    Ok(())
}

fn ship(criterion: &mut Criterion) -> Result<(), Error> {
    let mut group = criterion.benchmark_group("ship, a step");
    let set = wander(1.0, SAMPLES);
    let run = stepper::Run::new(&set, &[], 0.02, 4, Hold::First, 1)?;
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
    let twelve = [
        at::TAU_N,
        at::G,
        at::K_P,
        at::K_I,
        at::P,
        at::TAU_PROP,
        at::T_D,
        at::T_SET,
        at::TAU_ACT,
        at::S_U,
        at::S_M,
        at::INITIAL_N,
    ];
    group.throughput(Throughput::Elements(4 * SAMPLES as u64));
    for (name, wrt) in [("alone", &twelve[..0]), ("with twelve derivatives", &twelve[..])] {
        let task = stepper::Task { parameters, outputs: &outputs, wrt };
        let mut rows = vec![0.0; SAMPLES * outputs.len() * (1 + wrt.len())];
        group.bench_function(name, |bencher| {
            bencher.iter(|| stepper::simulate(black_box(&task), &run, &mut rows, &Stop::new()));
        });
    }
    group.throughput(Throughput::Elements(SAMPLES as u64));
    for place in [at::T_D, at::T_SET, at::TAU_ACT] {
        vector[place] = stepper::OFF[place];
    }
    let plain = stepper::Parameters::new(&vector, "parameters")?;
    let run = stepper::Run::new(&set, &[], 0.01, 1, Hold::Zero, 1)?;
    let mut rows = vec![0.0; SAMPLES * outputs.len()];
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

fn all(criterion: &mut Criterion) {
    for bench in [whole_drive_train, ship, products, signals] {
        bench(criterion).expect("inputs as the kernels want them");
    }
}

criterion_group! {
    name = kernels;
    config = Criterion::default().sample_size(20).warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(1));
    targets = all
}
criterion_main!(kernels);
