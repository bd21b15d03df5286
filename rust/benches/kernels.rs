//! Times of the kernels without Python: `cargo bench`.
#![allow(missing_docs)]

use std::hint::black_box;
use std::time::Duration;

use _core::cost::Objective;
use _core::error::Error;
use _core::filter::{Decimator, running_median};
use _core::integrate::{Hold, MethodName, ROWS, Rows, Runs, Scheme, simulate};
use _core::linear::{By, Drive, Output, Parameters};
use _core::plant::Envelope;
use _core::pulse::PulseCrossings;
use _core::stop::Stop;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};

/// The virtual launch, nonlinear and about its operating point.
const PLANT: [f64; 12] =
    [21.2, 3.0, 0.95, 27.0, -6.0, 0.0, 12.18, 2.0, 13.07, 6.03, 0.603, f64::NEG_INFINITY];
const LOOP: [f64; 9] = [1.5, -0.583, 1.583, 4.0, 1.0, 2.0, 1.0, 0.0, 0.0];
const SAMPLES: usize = 10_000;

/// A set point that wanders about `middle`.
fn wander(middle: f64, samples: usize) -> Vec<f64> {
    (0..samples).map(|k| middle * (1.0 + 0.05 * (k as f64 * 0.013).sin())).collect()
}

fn plant(criterion: &mut Criterion) -> Result<(), Error> {
    let mut group = criterion.benchmark_group("plant, RK4, a step");
    let set_speed = wander(21.7, SAMPLES);
    let scheme = Scheme::new(0.01, 1, MethodName::Rk4, Hold::Zero)?;
    let envelope = Envelope::new(&[], &[])?;
    for members in [1, 16, 64] {
        let parameters: Vec<f64> = PLANT.repeat(members);
        let initial: Vec<f64> = [7.2, 0.0].repeat(members);
        let rows = |values, columns| Rows { values, shape: [members, columns] };
        let common = Rows { values: &set_speed[..], shape: [1, SAMPLES] };
        let runs = Runs::many(rows(&parameters[..], 12), common, rows(&initial[..], 2))?;
        let mut output = vec![0.0; members * ROWS * SAMPLES];
        group.throughput(Throughput::Elements((members * SAMPLES) as u64));
        group.bench_function(format!("{members} side by side"), |bencher| {
            bencher.iter(|| simulate(black_box(&runs), &envelope, &scheme, 1, &mut output, &Stop::new()));
        });
    }
    group.finish();
    Ok(())
}

fn cost(criterion: &mut Criterion) -> Result<(), Error> {
    let mut group = criterion.benchmark_group("cost, a sample");
    let dn_set = wander(0.01, SAMPLES);
    let measured = vec![0.01; 2 * SAMPLES];
    let outputs = || vec![Output::Speed, Output::EngineTorque];
    let weight = [1.0, 0.0, 0.0, 1.0];
    let drive = Drive::new(&dn_set, 0.01, Hold::First, &[0.0, 0.0])?;
    let late =
        { LOOP.iter().zip([0.0; 7].iter().chain(&[0.12, 0.035])).map(|(a, b)| a + b).collect::<Vec<_>>() };
    for (name, vector, wrt) in [
        ("one vector", &LOOP[..], vec![]),
        ("derivatives by seven", &LOOP[..], vec![0, 1, 2, 3, 4, 5, 6]),
        ("derivatives by seven, both dead times", &late[..], vec![0, 1, 2, 3, 4, 7, 8]),
    ] {
        let objective = Objective::new(drive, outputs(), &measured, &weight, By::from_indices(&wrt)?)?;
        let parameters = Parameters::new(vector, "parameters")?;
        group.throughput(Throughput::Elements(SAMPLES as u64));
        group.bench_function(name, |bencher| {
            bencher.iter(|| objective.evaluate(black_box(&parameters), &Stop::new()));
        });
    }
    let objective = Objective::new(drive, outputs(), &measured, &weight, vec![])?;
    let vectors = vec![Parameters::new(&LOOP, "parameters")?; 16];
    group.throughput(Throughput::Elements(16 * SAMPLES as u64));
    group.bench_function("sixteen vectors", |bencher| {
        bencher.iter(|| objective.evaluate_batch(black_box(&vectors), 1, &Stop::new()));
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
    for bench in [plant, cost, signals] {
        bench(criterion).expect("inputs as the kernels want them");
    }
}

criterion_group! {
    name = kernels;
    config = Criterion::default().sample_size(20).warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(1));
    targets = all
}
criterion_main!(kernels);
