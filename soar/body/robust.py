"""The robust loss and the optimiser of every fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import torch
from torch import Tensor

from soar.errors import NumericalError


def geman_mcclure(square: Tensor, sigma: float) -> Tensor:
    """``s^2 r^2 / (s^2 + r^2)`` of squared residuals ``r^2``: quadratic near zero, at most ``s^2``."""
    return square / (1 + square / sigma**2)


def minimise(
    terms: Callable[[], Mapping[str, Tensor]], parameters: Sequence[Tensor], *, steps: int, iterations: int, what: str
) -> dict[str, float]:
    """Minimise the sum of named terms by L-BFGS (rate 1, strong Wolfe line search).

    Args:
        terms: evaluates every term at the current parameters.
        parameters: leaf tensors, changed in place.
        steps: calls of the optimiser.
        iterations: iterations of one call.
        what: the name of the optimisation, for messages.

    Returns:
        the value of each term at the end.

    Raises:
        NumericalError: a term or a gradient became NaN or infinite; the parameters are then those of the last finite
            evaluation.
    """
    optimiser = torch.optim.LBFGS(
        list(parameters), lr=1.0, max_iter=iterations, history_size=20, line_search_fn="strong_wolfe"
    )
    kept = [p.detach().clone() for p in parameters]

    def closure() -> Tensor:
        optimiser.zero_grad()
        values = terms()
        bad = [name for name, value in values.items() if not bool(torch.isfinite(value))]
        total = torch.stack(list(values.values())).sum()
        if not bad:
            total.backward()
            if not all(bool(torch.isfinite(p.grad).all()) for p in parameters if p.grad is not None):
                bad = ["gradient"]
        if bad:
            for parameter, value in zip(parameters, kept, strict=True):
                parameter.data.copy_(value)
            raise NumericalError(
                f"{what} became NaN or infinite", expected="finite terms", got=", ".join(bad),
                cure="check calibration and keypoints; lower the weight of the term named",
            )  # fmt: skip
        for parameter, value in zip(parameters, kept, strict=True):
            value.copy_(parameter.detach())
        return total

    for _ in range(steps):
        optimiser.step(closure)
    with torch.no_grad():
        return {name: float(value) for name, value in terms().items()}
