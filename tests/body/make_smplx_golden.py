"""Writes ``data/smplx_golden.npz``: what the official package ``smplx`` (0.1.28) makes of the random files.

To be run by hand where that package is installed: ``python -m tests.body.make_smplx_golden``. The file holds, for each
case (components of the file, PCA coefficients of a hand or full, flat hand mean), float32 vertices (3, 21, 3), every
499th, and joints (3, 144, 3) with the contour, computed in float64.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import torch

from tests.body.official import BETAS, CASES, EXPRESSION, FRAMES, SUBSET, arrays, parameters, write

GOLDEN = Path(__file__).parent / "data" / "smplx_golden.npz"


def main() -> None:
    from smplx import SMPLX

    found: dict[str, np.ndarray] = {}
    with tempfile.TemporaryDirectory() as folder:
        for components in BETAS:
            path = write(Path(folder) / "SMPLX_NEUTRAL.npz", arrays(components))
            for case in (case for case in CASES if case[0] == components):
                _, hands, flat = case
                model = SMPLX(
                    str(path), num_betas=BETAS[components], num_expression_coeffs=EXPRESSION[components],
                    use_pca=hands != "full", num_pca_comps=45 if hands == "full" else hands, flat_hand_mean=flat,
                    use_face_contour=True, batch_size=FRAMES, dtype=torch.float64,
                )  # fmt: skip
                output = model(**{name: torch.from_numpy(v) for name, v in parameters(components, hands).items()})
                name = "_".join(map(str, case))
                found[f"{name}_vertices"] = output.vertices.detach().numpy()[:, SUBSET].astype(np.float32)
                found[f"{name}_joints"] = output.joints.detach().numpy().astype(np.float32)
    np.savez_compressed(GOLDEN, **found)


if __name__ == "__main__":
    main()
