"""Error estimates by iterations and by a factorization in the finer spaces: seconds, and the largest error.

"Operations" count the factorization; from `hpcinv.trust.discretisation.two_level.MANY` on, iterations are made.

Command: python benchmarks/two_level.py [--sizes 3000 6000 12000 20000] [--bodies beam block]
"""

from __future__ import annotations

import argparse
import math
from typing import Any

import hpcinv.base.parallel.runtime  # its import order first

# isort: split
from bodies import beam, block, sphere

import hpcinv
from hpcinv.trust.discretisation import two_level
from hpcinv.trust.discretisation.finer_solid import FinerSolid

BODIES = {"beam": beam, "block": block, "sphere": sphere}


def estimated(job: Any, many: float) -> tuple[float, float]:
    """Return the seconds of the estimate, and its error of the shape (m); kernels are compiled beforehand."""
    two_level.MANY = many
    hpcinv.run(job, progress=False)
    result = hpcinv.run(job, progress=False)
    (line,) = (line for line in result.certificate.lines if line.name.startswith("discretisation error"))
    assert result.estimate is not None
    assert line.seconds is not None
    return line.seconds, result.estimate.shape


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[3000, 6000, 12000, 20000], help="unknowns, about")
    parser.add_argument("--bodies", nargs="+", choices=BODIES, default=["beam", "block"])
    options = parser.parse_args()
    operations: list[float] = []
    forecast = FinerSolid.forecast

    def noted(equations: Any) -> Any:
        costs = forecast(equations)
        operations.append(costs.operations)
        return costs

    FinerSolid.forecast = staticmethod(noted)  # type: ignore[assignment, method-assign]
    print(f"{'body':20}{'unknowns':>10}{'operations':>12}{'factorized':>12}{'iterated':>10}{'ratio of errors':>17}")
    for name in options.bodies:
        for size in options.sizes:
            for analysis in ("inverse", "forward"):
                job = hpcinv.load(BODIES[name](size, analysis=analysis, certificate={"level": "off", "estimate": True}))
                (exact, error), (rough, rough_error) = (estimated(job, many) for many in (math.inf, 0.0))
                row = f"{exact:10.2f} s{rough:8.2f} s{rough_error / error:17.3f}"
                print(f"{name + ', ' + analysis:20}{size:10}{operations[-1]:12.1e}{row}", flush=True)


if __name__ == "__main__":
    main()
