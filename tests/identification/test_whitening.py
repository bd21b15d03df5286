"""Residuals weighed by frequency: noise that drives all outputs at once comes out white, and estimates scatter as told."""

import numpy as np
import pytest
from scipy.signal import lfilter

from shipfp_rs.identification.whitening import Evaluation, Whitening, autoregressive_model
from shipfp_rs.optimise.normal_equations import Products

SAMPLES = 6000


def watery(seed, samples=SAMPLES):
    """Slow noise of one source in two outputs, the second one later and less, with noise of their own (2, N)."""
    random = np.random.default_rng(seed)
    source = lfilter([0.03], [1.0, -0.97], random.standard_normal(samples))
    noise = random.standard_normal((2, samples)) * [[0.02], [0.05]]
    noise[0] += source
    noise[1, 3:] -= 0.7 * source[:-3]
    return noise


def found(noise, jacobian=None):
    valid = np.ones(noise.shape[1], dtype=bool)
    jacobian = np.zeros((0, *noise.shape)) if jacobian is None else jacobian
    evaluation = Evaluation(noise, jacobian, valid)
    models = [autoregressive_model([(row, valid)], 8) for row in noise]
    return evaluation, *Whitening(models).coloured(evaluation)


def test_noise_of_one_source_comes_out_white_and_free_of_the_other_output():
    evaluation, whitening, _ = found(watery(1))
    left = whitening(evaluation)
    rows = left.residual[:, left.valid]
    for lag in range(6):
        across = rows[:, lag:] @ rows[:, : rows.shape[1] - lag].T / rows.shape[1]
        # Power added to the spectra is missing at low frequencies, where the noise of both outputs is one.
        expected = np.diag(np.diag(across)) if lag == 0 else 0.0
        np.testing.assert_allclose(across, expected, atol=0.1)
    assert (rows.var(axis=1) > 0.8).all()
    assert (rows.var(axis=1) < 1.05).all()


def test_products_are_those_of_the_whitened_columns():
    random = np.random.default_rng(2)
    evaluation, whitening, _ = found(
        watery(2), lfilter([0.1], [1.0, -0.9], random.normal(size=(3, 2, SAMPLES)))
    )
    evaluation.valid[2000:2050] = False
    evaluation.residual[:, 2000:2050] = 0.0
    evaluation.jacobian[..., 2000:2050] = 0.0
    whole = whitening.products(evaluation)
    left = whitening(evaluation)
    plain = Products.of(left.residual, left.jacobian, int(left.valid.sum()))
    assert whole.count == plain.count == SAMPLES - 8 - 58
    size = np.sqrt(np.einsum("oaoa->oa", whole.sums)).ravel()
    unit = np.outer(size, size).reshape(whole.sums.shape)
    np.testing.assert_allclose(whole.sums / unit, plain.sums / unit, atol=2e-3)


def test_the_deviance_of_white_noise_is_that_of_its_covariance():
    root = np.array([[2.0, 0.0], [1.0, 0.5]])
    noise = root @ np.random.default_rng(3).standard_normal((2, 20000))
    evaluation = Evaluation(noise, np.zeros((0, *noise.shape)), np.ones(20000, dtype=bool))
    _, deviance = Whitening([np.ones(1)] * 2).coloured(evaluation)
    floor = np.cov(noise) + np.diag(0.1 * np.diag(root @ root.T))
    assert deviance == pytest.approx(20000 * np.linalg.slogdet(floor)[1], abs=0.05 * 20000)


def test_estimates_scatter_as_told_and_less_than_with_each_output_by_itself():
    time = np.arange(SAMPLES)
    angle = 0.02 * time + 5e-5 * time**2
    signal = np.stack([np.sin(angle), 0.5 * np.cos(angle)])
    z, ratio = [], []
    for seed in range(60):
        evaluation, whitening, _ = found(watery([4, seed]), signal[None])
        sums = whitening.products(evaluation)
        gram = np.einsum("oaob->ab", sums.sums)
        z.append(gram[0, 1] / np.sqrt(gram[0, 0]))
        left = Whitening(whitening.models)(evaluation)
        rows = np.concatenate([left.jacobian, left.residual[None]])[..., left.valid]
        weight = np.linalg.inv(np.cov(left.residual[:, left.valid]))
        single = np.einsum("aon,op,bpn->ab", rows, weight, rows, optimize=True)
        ratio.append(abs(single[0, 1] / single[0, 0]) - abs(gram[0, 1] / gram[0, 0]))
    assert 0.75 < np.sqrt(np.mean(np.square(z))) < 1.3
    assert np.mean(ratio) > 0.0
