"""The checks of docs/concepts/physics.md: `python docs/_tools/physics_table.py`.

A row a case: what comes closest to its limit, in MuJoCo at 1 ms or, without a motion, in the core.
"""

from benchmarks.verification.cases import CASES
from benchmarks.verification.report import closest

ROUNDING = 1e-11  # What is left of it differs between processors.


def main() -> None:
    """Prints the table."""
    print("| case | closest row | deviation | allowed |\n|---|---|---|---|")
    for name, case in CASES.items():
        worst = closest(row for row in case() if row.solver in ("core", "MuJoCo 1 ms"))
        quantity, deviation = worst.quantity, f"{worst.deviation:.1e}"
        if worst.deviation < ROUNDING:
            quantity, deviation = "all", "rounding"
        print(f"| {name} | {quantity} | {deviation} | {worst.tolerance:.0e} |")


if __name__ == "__main__":
    main()
