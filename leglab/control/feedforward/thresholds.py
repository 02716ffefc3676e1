"""Thresholds of live fault names and of slow wear, each with its reason.

Users may set further thresholds in `JudgeConfiguration` and its subclasses. Thresholds of squared
errors and sizes are ratios, valid for any machine. Times and numbers of learned samples hold for a
reference of period `STRIDE`; for another period all but `PASSING` are scaled in proportion.
"""

# Period of the reference for which the times below hold [s].
STRIDE = 1.2

# Criteria for reporting a fault by name.

# Standard deviation of the share of the error that the true fault leaves unexplained, because no
# machine equals its nominal model: it is as if two components differed from the model by a tenth.
DISCREPANCY = 0.15
# Ratio of a joint's mean squared error to its normal value above which the joint counts as affected
# by a change; in a sound machine the strides differ by less.
CHANGED = 2.0
# Ratio as `CHANGED`, for the map before the change, above which a change that no fault explains is
# reported (about threefold RMS error). It is high, because the report has no other evidence.
UNEXPLAINED = 10.0
# `ALIKE`: ratio of probabilities up to which less probable faults are reported with the most
# probable one, because each may be true. `TOLD`: maximum number of faults in a report.
ALIKE, TOLD = 4.0, 3
# Half length of a 90 % interval of a normal distribution, in standard deviations.
NINETY = 1.645
# Ridge penalty on the difference of the healthy map's parameters from the learner's. Where the
# motion does not excite a direction of parameter space, it keeps the learner's parameters.
RIDGE = 1e-2

# Abrupt changes.

# `LOOKS`: times after the onset of a change at which the bank of faults is fitted [s], dense at
# first, when evidence accumulates fast. The examination of a change ends at the last of these
# times, or when a name is `STEADY` [s] old; then another change can be detected.
_EARLY = (0.09, 0.12, 0.15, 0.18, 0.22, 0.26, 0.3, 0.36, 0.43, 0.5, 0.6, 0.72, 0.86, 1.0)
LOOKS = (*_EARLY, 1.2, 1.4, 1.7, 2.0, 2.4, 2.8, 3.2)
STEADY = 2.0
# Times after an onset [s] between which the requirements for a name fall from the first to the
# second value of a setting: `GROWN` for `MonitorConfiguration.explained`, `PROVEN` for `proof`.
GROWN, PROVEN = (0.1, 0.4), (0.1, 0.6)
# Time after an onset during which samples are ignored [s]: duration of the transient of valves and
# oil. It is not scaled, because the transient does not depend on the period of the motion.
PASSING = 0.06
# Number of past sample blocks that are searched for the onset after an alarm: 0.5 s at 500 Hz.
BLOCKS = 25
# `PATIENCE`: age at which an unexplained change is reported [s], about a stride, because errors due
# to a new motion end by then. `RECENT`: time over which its errors are averaged [s], half a stride.
PATIENCE, RECENT = 1.3, 0.65
# Maximum number of faults whose maps are proposed after a fit: each map costs computing time.
CONTENDERS = 3
# Time after the examination of a change during which the map without a fault still contends [s]:
# 2.5 strides, because a named fault's map learns the remaining errors only slowly.
AFTER = 3.0
# Time after an onset after which no map is proposed [s], because the learner has adapted by then.
LATE = 1.0
# Maximum number of persistent changes that are remembered: each adds a curve to the bank.
MOST_STANDING = 4
# Share of a change's learned parameter shift that must disappear for the change to count as undone;
# the remaining share is then at most twice `DISCREPANCY`.
UNDONE = 0.7

# Slow wear.

# Number of looks (evaluated segments of samples, see `health`) that are judged together, because a
# single look may contain an unusual motion.
TOGETHER = 3
# Maximum number of looks whose sizes are kept; longer histories are thinned out.
MOST_LOOKS = 1024
# `FEWEST`: minimum number of looks for a line. `MANY`: number of looks from which on only the later
# half is fitted, because a line through all looks underestimates accelerating wear.
FEWEST, MANY = 4, 16
# Probability that a value lies outside its 90 % interval, both sides together.
OUTSIDE = 0.1
