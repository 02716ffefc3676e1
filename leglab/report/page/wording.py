"""Names, numbers and lists as one reads them. Plain text: the page escapes it."""

import math


def printable(text: str) -> str:
    """The text with control characters, which no page may hold, made visible."""
    return "".join(c if c.isprintable() or c == " " else "\ufffd" for c in text)


def readable(name: str) -> str:
    """A name as one reads it: "valve_deadband" becomes "valve deadband"."""
    return name.replace("_", " ")


def listed(names: tuple[str, ...], word: str = "and") -> str:
    """Joins names as in a sentence: "a, b and c"."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {word} {names[-1]}"


def shortened(name: str, most: int) -> str:
    """The name, cut in the middle where it has more characters."""
    if len(name) <= most:
        return name
    return f"{name[: most // 2]}\u2026{name[len(name) - (most - most // 2 - 1) :]}"


def readable_unit(unit: str) -> str:
    """A unit as one reads it; empty for "1"."""
    return {"1": "", "degC": "\u00b0C"}.get(unit, unit)


def capital(text: str) -> str:
    """The text with its first letter capital, the others as they are."""
    return f"{text[:1].upper()}{text[1:]}"


def number(value: float, digits: int = 3) -> str:
    """Few digits, powers of ten only where they are short; "unknown" for what is not finite."""
    if not math.isfinite(value):
        return "unknown"
    rounded = float(f"{value:.{digits}g}")
    if 1e2 <= abs(rounded) < 1e6:
        decimals = max(0, digits - 1 - math.floor(math.log10(abs(rounded))))
        return f"{rounded:,.{decimals}f}"
    return f"{rounded:.{digits}g}"


def figure(value: float | None, factor: float = 1.0, *, missing: str = "") -> str:
    """A number in a table, times a factor; `missing` where there is none or it is not finite."""
    return missing if value is None or not math.isfinite(value) else number(factor * value)


def log_ticks(low: float, high: float, *, fine: bool) -> list[float]:
    """Round numbers about the ends of a logarithmic axis.

    Args:
        low: Logarithm of the lower end.
        high: Logarithm of the upper end.
        fine: Whether there are 1, 2 and 5 of each power of ten, or that alone.
    """
    factors = (1, 2, 5) if fine else (1,)
    powers = range(math.floor(low) - 1, math.ceil(high) + 1)
    return [float(f"{factor}e{power}") for power in powers for factor in factors]
