"""What lagged inputs still explain of a fit's residuals, said plainly in NumPy."""

import numpy as np


def leftover_sums(set_points, lags, slopes, mix, residuals, valid, models):
    """Lay down every row, multiply, run backwards through the recursion, and multiply again."""
    samples, reach = len(valid), max(lags)
    inputs = np.array(
        [[row[reach - lag : reach - lag + samples] * valid for lag in lags] for row in set_points]
    )
    basis = (mix[..., :-1] @ slopes + mix[..., -1:]) * valid
    with_residual = np.concatenate([basis, residuals[:, None]], axis=1)
    rows = []
    for output, model in enumerate(models):
        own = np.concatenate([inputs[min(output, len(inputs) - 1)], basis[output]])
        later = np.pad(own, [(0, 0), (0, len(model))])
        for k in reversed(range(samples)):
            later[:, k] -= later[:, k + 1 : k + 1 + len(model)] @ model
        rows.append(later[:, :samples])
    coloured = np.einsum("oas,pbs->oapb", rows, rows)
    return (
        np.einsum("pls,obs->plob", inputs, with_residual),
        np.einsum("pls,pls->pl", inputs, inputs),
        coloured,
    )
