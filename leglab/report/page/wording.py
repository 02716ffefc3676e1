"""Formatting of names, numbers and lists for readers, as plain text: the page escapes it."""

import math


def printable(text: str) -> str:
    """Replaces non-printable characters, which no page may contain, by a visible one."""
    return "".join(c if c.isprintable() or c == " " else "\ufffd" for c in text)


def readable(name: str) -> str:
    """Replaces underscores by spaces: "valve_deadband" becomes "valve deadband"."""
    return name.replace("_", " ")


def listed(names: tuple[str, ...], word: str = "and") -> str:
    """Joins names as in a sentence: "a, b and c"."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {word} {names[-1]}"


def shortened(name: str, most: int) -> str:
    """Cuts a name in the middle if it has more than `most` characters."""
    if len(name) <= most:
        return name
    return f"{name[: most // 2]}\u2026{name[len(name) - (most - most // 2 - 1) :]}"


def readable_unit(unit: str) -> str:
    """Returns a unit as readers write it: "°C" for "degC", empty for "1"."""
    return {"1": "", "degC": "\u00b0C"}.get(unit, unit)


def capital(text: str) -> str:
    """Capitalises the first letter of a text and leaves the others unchanged."""
    return f"{text[:1].upper()}{text[1:]}"


def number(value: float, digits: int = 3) -> str:
    """Formats significant digits, without exponent from 1e-4 to 1e6; "unknown" if not finite."""
    if not math.isfinite(value):
        return "unknown"
    rounded = float(f"{value:.{digits}g}")
    if 1e2 <= abs(rounded) < 1e6:
        decimals = max(0, digits - 1 - math.floor(math.log10(abs(rounded))))
        return f"{rounded:,.{decimals}f}"
    return f"{rounded:.{digits}g}"


def figure(value: float | None, factor: float = 1.0, *, missing: str = "") -> str:
    """Formats `value * factor` for a table; returns `missing` for None and non-finite values."""
    return missing if value is None or not math.isfinite(value) else number(factor * value)


def log_ticks(low: float, high: float, *, fine: bool) -> list[float]:
    """Returns round numbers over a logarithmic axis and somewhat beyond its ends.

    Args:
        low: Decimal logarithm of the lower end.
        high: Decimal logarithm of the upper end.
        fine: Whether to return 1, 2 and 5 times each power of ten, or the powers alone.
    """
    factors = (1, 2, 5) if fine else (1,)
    powers = range(math.floor(low) - 1, math.ceil(high) + 1)
    return [float(f"{factor}e{power}") for power in powers for factor in factors]
