"""C headers of models for microcontrollers: one step and free run, without heap or library."""

import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from leglab.base.errors import SettingsError
from leglab.identification.spline_narx import ParameterBlock, SplineNarx
from leglab.identification.spline_state_space import REACH, SplineStateSpace

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

_HEAD = """\
/* {output} from {inputs}, sampled every {period:.9g} s. Made by leglab identify.
 *
 *   {name}_state s = {{0}};             past signals in the middle of their ranges. {lags} calls
 *                                      of predict and put, with measured y, replace them.
 *   double u[{count}] = {{...}};
 *   double y = {name}_predict(&s, u);   prediction of y(t), from y up to t - 1 and u up to t
 *   {name}_put(&s, y);                  for a free run; or the measured y(t)
 */
#ifndef LEGLAB_{upper}_H
#define LEGLAB_{upper}_H

#ifndef LEGLAB_SIGN
#define LEGLAB_SIGN
static inline double leglab_sign(double s) {{
  const double a = s < 0 ? -s : s, q = a * (a + 0.5), share = 0.5 / (q + 0.5);
  return s < 0 ? share - 1 : 1 - share;
}}
#endif

#define {upper}_INPUTS {count}
#define {upper}_LAGS {lags}

typedef struct {{
  double y[{upper}_LAGS + 1];
  double u[{upper}_INPUTS][{upper}_LAGS + 1];
}} {name}_state;

static inline double {name}_predict({name}_state *s, const double *u) {{
  static const double centre[] = {{{centres}}};
  static const double half[] = {{{halves}}};
  for (int j = 0; j < {upper}_INPUTS; ++j) {{
    for (int k = {upper}_LAGS; k > 0; --k) s->u[j][k] = s->u[j][k - 1];
    s->u[j][0] = (u[j] - centre[j + 1]) / half[j + 1];
  }}
  double sum = 0.0;
"""
_TAIL = """\
  const double y = centre[0] + half[0] * sum;
  return {held};
}}

static inline void {name}_put({name}_state *s, double y) {{
  for (int k = {upper}_LAGS; k > 1; --k) s->y[k] = s->y[k - 1];
  s->y[1] = (y - {centre}) / {half};
}}

#endif
"""
_SPLINE = """\
  {{  /* curve of {x} */
    static const double from[] = {{{ends}}};
    static const double c[][3] = {{{pieces}}};
    double x = {x}, inside = x < from[0] ? from[0] : x > from[{last}] ? from[{last}] : x;
    int i = 0;
    while (i < {most} && inside >= from[i + 1]) ++i;
    const double d = inside - from[i];
    double value = c[i][0] + d * (c[i][1] + d * c[i][2]);
    value += (x - inside) * {slope};
    sum += value{factor};
  }}
"""


_STATES_HEAD = """\
/* {output} from {inputs}, sampled every {period:.9g} s. Made by leglab identify.
 *
 *   {name}_state s = {{0}};             the middle of the range of all states, which is forgotten
 *                                      as the machine forgets how it was set in motion.
 *   double u[{count}] = {{...}};
 *   double y = {name}_next(&s, u);      output of the model at this sample
 */
#ifndef LEGLAB_{upper}_H
#define LEGLAB_{upper}_H

#define {upper}_STATES {states}
#define {upper}_INPUTS {count}
#define {upper}_CURVES {curves}
#define {upper}_DEPTH {depth}

typedef struct {{
  double x[{upper}_STATES];
  double u[{upper}_INPUTS][{upper}_DEPTH + 1];
}} {name}_state;

static inline double {name}_next({name}_state *s, const double *u) {{
  enum {{ n = {upper}_STATES, m = {upper}_STATES + {upper}_INPUTS }};
  static const double centre[] = {{{centres}}};
  static const double half[] = {{{halves}}};
  static const int delay[] = {{{delays}}};
  static const double linear[n + 1][m] = {{{linear}}}; /* A B; C D */
  double now[m], sum[n + 1];
  for (int i = 0; i < n; ++i) now[i] = s->x[i];
  for (int j = 0; j < {upper}_INPUTS; ++j) {{
    for (int k = {upper}_DEPTH; k > 0; --k) s->u[j][k] = s->u[j][k - 1];
    s->u[j][0] = (u[j] - centre[j + 1]) / half[j + 1];
    now[n + j] = s->u[j][delay[j]];
  }}
  for (int i = 0; i <= n; ++i) {{
    sum[i] = i < n ? 0.0 : {constant};
    for (int k = 0; k < m; ++k) sum[i] += linear[i][k] * now[k];
  }}
"""
_STATES_CURVES = """\
  static const double v[][m] = {{{v}}};
  static const double w[][n + 1] = {{{w}}};
  static const double from[] = {{{ends}}};
  static const double c[][{most} + 1][3] = {{{pieces}}};
  for (int k = 0; k < {upper}_CURVES; ++k) {{
    double z = 0.0;
    for (int i = 0; i < m; ++i) z += v[k][i] * now[i];
    const double inside = z < from[0] ? from[0] : z > from[{last}] ? from[{last}] : z;
    int i = 0;
    while (i < {most} && inside >= from[i + 1]) ++i;
    const double d = inside - from[i];
    double f = c[k][i][0] + d * (c[k][i][1] + d * c[k][i][2]);
    f += (z - inside) * (c[k][i][1] + 2 * d * c[k][i][2]);
    for (int j = 0; j <= n; ++j) sum[j] += w[k][j] * f;
  }}
"""
_STATES_TAIL = """\
  for (int i = 0; i < n; ++i) {{
    s->x[i] = sum[i] < -{reach} ? -{reach} : sum[i] > {reach} ? {reach} : sum[i];
  }}
  const double y = centre[0] + half[0] * sum[n];
  return {held};
}}

#endif
"""


def c_header(model: SplineNarx | SplineStateSpace, name: str, period: float) -> str:
    """Returns the C header of a model with its current parameters.

    Args:
        model: A state-space model, or a NARX model of lags, terms, splines and a constant.
        name: Prefix of functions and types; characters that C forbids become _.
        period: Sampling period [s], for the comment.

    Raises:
        SettingsError: The model has a Hammerstein feature, which has no C form.
    """
    settings = model.settings
    name = re.sub(r"\W", "_", name)
    name = name if re.match(r"[A-Za-z_]", name) else f"m_{name}"
    signals = settings.signals
    words: dict[str, object] = {
        "name": name,
        "upper": name.upper(),
        "lags": model.lags,
        "count": len(settings.inputs),
        "output": settings.output.name.replace("*/", "* /"),
        "inputs": ", ".join(s.name for s in settings.inputs).replace("*/", "* /"),
        "period": period,
        "centres": _listed([s.centre for s in signals]),
        "halves": _listed([s.half_range for s in signals]),
        "centre": _number(signals[0].centre),
        "half": _number(signals[0].half_range),
        "held": "y",
    }
    if settings.free_run_limits is not None:
        low, high = map(_number, settings.free_run_limits)
        words["held"] = f"y < {low} ? {low} : y > {high} ? {high} : y"
    if isinstance(model, SplineStateSpace):
        return _state_space(model, words)
    parts = [_HEAD.format(**words)]
    for block, theta, _ in model.learned_blocks():
        parts.append(_block(block, theta))
    return "".join([*parts, _TAIL.format(**words)])


def _state_space(model: SplineStateSpace, words: dict[str, object]) -> str:
    parts, structure = model.parts(), model.settings.structure
    ends = np.array(structure.basis.knots)
    words |= {
        "states": structure.states,
        "reach": REACH,
        "curves": structure.curves,
        "depth": max(structure.delays),
        "delays": ", ".join(map(str, structure.delays)),
        "linear": _rows(np.block([[parts.A, parts.B], [parts.C[None], parts.D[None]]])),
        "constant": _number(parts.d),
        "v": _rows([c.v for c in parts.curves]),
        "w": _rows([np.append(c.w, c.o) for c in parts.curves]),
        "ends": _listed(ends),
        "last": len(ends) - 1,
        "most": len(ends) - 2,
        "pieces": ", ".join(
            f"{{{_rows(_pieces(structure.basis.spline(c.e), ends))}}}" for c in parts.curves
        ),
    }
    text = _STATES_HEAD + (_STATES_CURVES if structure.curves else "") + _STATES_TAIL
    return text.format(**words)


def _pieces(spline: "BSpline", ends: np.ndarray) -> list[list[float]]:
    """Returns the polynomial coefficients of a spline between its knots, constant term first."""
    return [[float(spline(a)), float(spline(a, 1)), float(spline(a, 2)) / 2] for a in ends[:-1]]


def _block(block: ParameterBlock, theta: np.ndarray) -> str:
    if block.feature == "constant":
        return f"  sum += {_number(theta[0])};\n"
    if block.feature == "lags":
        lines = [
            f"  sum += {_number(theta[k])} * {_at(block.signal, block.lag + k)};\n"
            for k in range(block.lags)
        ]
        return "".join(lines)
    factor = "" if block.factor_signal < 0 else f" * {_at(block.factor_signal, block.factor_lag)}"
    x = _at(block.signal, block.lag)
    if block.feature == "term":
        if block.change:
            x = f"({x} - {_at(block.signal, block.lag + 1)})"
        d = f"({x} - {_number(block.at)})"
        s = f"{d} / {_number(block.width)}"
        g = {
            "power": " * ".join([x] * block.degree),
            "hinge": f"({d} > 0 ? {d} : 0)",
            "sign": f"leglab_sign({s})",
        }[block.curve]
        return f"  sum += {_number(theta[0])} * {g}{factor};\n"
    if block.feature != "spline" or block.basis is None:
        text = f"a {block.feature} feature has no C form; allowed: "
        raise SettingsError(text, given=block.feature, allowed="lags, constant, spline, term")
    return _curve(block, theta, x, factor)


def _curve(block: ParameterBlock, theta: np.ndarray, x: str, factor: str) -> str:
    basis = block.basis
    assert basis is not None
    spline = basis.spline(theta)
    ends = np.array(basis.knots)
    if basis.outside == "linear":
        first, last = float(spline(ends[0], 1)), float(spline(ends[-1], 1))
        slope = f"(x < inside ? {_number(first)} : {_number(last)})"
    else:
        slope = "0.0"
    return _SPLINE.format(
        x=x,
        ends=_listed(ends),
        pieces=_rows(_pieces(spline, ends)),
        last=len(ends) - 1,
        most=len(ends) - 2,
        slope=slope,
        factor=factor,
    )


def _at(signal: int, lag: int) -> str:
    return f"s->y[{lag}]" if signal == 0 else f"s->u[{signal - 1}][{lag}]"


def _listed(values: Sequence[float] | np.ndarray) -> str:
    return ", ".join(map(_number, values))


def _rows(table: Iterable[Sequence[float] | np.ndarray]) -> str:
    return ", ".join(f"{{{_listed(row)}}}" for row in table)


def _number(value: float) -> str:
    """Returns a number as a C floating-point constant that reproduces all its bits."""
    text = repr(float(value))
    text = text if any(sign in text for sign in ".en") else f"{text}.0"
    return f"({text})" if text.startswith("-") else text
