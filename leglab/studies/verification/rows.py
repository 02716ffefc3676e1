"""One line of a verification table."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Row:
    """A quantity, what it should be and what came out.

    Attributes:
        case: Letter of the case in the table of physics.md, or a word for the others.
        quantity: What is compared.
        solver: What computed it: "core", "continuous", or "MuJoCo" with its time step.
        unit: Unit of `expected` and `got`.
        expected: Value of the closed form.
        got: Computed value.
        tolerance: Largest allowed `deviation`.
        scale: What deviations are relative to; 0 stands for |expected|.
    """

    case: str
    quantity: str
    solver: str
    unit: str
    expected: float
    got: float
    tolerance: float
    scale: float = 0.0

    @property
    def deviation(self) -> float:
        """Relative deviation of `got` from `expected`."""
        return abs(self.got - self.expected) / (self.scale or abs(self.expected))

    @property
    def passed(self) -> bool:
        """Whether the deviation is within the tolerance; a NaN is not."""
        return self.deviation <= self.tolerance
