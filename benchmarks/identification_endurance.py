"""10^8 adversarial updates, double and single precision: parameters stay finite, F stays SPD.

    python benchmarks/identification_endurance.py [--updates 100000000]

The same samples and checks as tests/identification/test_identification_robustness.py, which
runs 10^6.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
import test_identification_robustness as robustness

from leglab.identification import BsnnArx, BsnnArxSettings, Rls
from tests.reference import adversary


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--updates", type=int, default=100_000_000)
    updates = parser.parse_args().updates
    paper = BsnnArxSettings.paper_mode()
    for scalar in robustness.SCALARS:
        for name, rls in robustness.RLS.items():
            network = paper.network
            settings = BsnnArxSettings(network=network, rls=rls, scalar=scalar, opening=4.0)
            endure(f"BsnnArx {name} {scalar}", BsnnArx(settings), updates)
        for after in (0, 1000):
            model = robustness.narx(scalar, Rls.adaptive(), after, plausible_range=0.0)
            endure(f"SplineNarx after {after} {scalar}", model, updates)


def endure(name: str, model: object, updates: int) -> None:
    rng, start = np.random.default_rng(21), time.perf_counter()
    for u, y in adversary.samples(updates, rng):
        model.run(u, y, missing="skip")
        robustness.assert_sound(model)
    spent = time.perf_counter() - start
    report = model.diagnostics()
    least = min(model._bank.gain_diagonal(0))
    print(
        f"{name}: {updates} updates in {spent:.0f} s, learned {report['learned']}, "
        f"rejected {report['rejected']}, trace {report['gain_trace']:.3g}, least D {least:.3g}",
        flush=True,
    )


if __name__ == "__main__":
    main()
