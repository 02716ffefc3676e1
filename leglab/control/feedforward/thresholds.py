"""Thresholds of live fault names and of slow wear, each with its reason.

Users may set further thresholds in `JudgeConfiguration` and its subclasses. Thresholds of squared
errors and sizes are ratios, valid for any machine. Times and numbers of learned samples hold for a
reference of period `STRIDE`; for another period they are scaled in proportion, except `PASSING`.
"""

# Period of the reference for which the times below hold [s].
STRIDE = 1.2

# Criteria for reporting a fault by name.

# Standard deviation of the share of the error that the true fault leaves, because no machine equals
# its nominal model: the effect of two components that differ from their data by a tenth each.
DISCREPANCY = 0.15
# Ratio of a joint's mean square error to its normal value above which a change affects the joint;
# in a sound machine the strides differ by less.
CHANGED = 2.0
# The same ratio, with the error of the map before the change, above which an unexplained change is
# reported: about three times the RMS error. It is high because no fault supports the report.
UNEXPLAINED = 10.0
# `ALIKE`: faults whose probability is within this factor of the most probable one are reported with
# it, since one name would hide that several fit. `TOLD`: maximum number of faults in a report.
ALIKE, TOLD = 4.0, 3
# Half length of a 90 % interval of a normal distribution, in standard deviations.
NINETY = 1.645
# Ridge penalty on the difference of the fitted healthy map from the learner's parameters, which it
# keeps in the directions of parameter space that the motion does not excite.
RIDGE = 1e-2

# Abrupt changes.

# Times after the onset of a change at which the bank is fitted [s], dense at first, when evidence
# accumulates fast. A case (the examination of one change) ends at the last time, or once a name has
# been in force for `STEADY` [s]; then another change can be detected.
_EARLY = (0.09, 0.12, 0.15, 0.18, 0.22, 0.26, 0.3, 0.36, 0.43, 0.5, 0.6, 0.72, 0.86, 1.0)
LOOKS = (*_EARLY, 1.2, 1.4, 1.7, 2.0, 2.4, 2.8, 3.2)
STEADY = 2.0
# Times after an onset [s] between which the explained share (`GROWN`) and the evidence (`PROVEN`)
# that a name requires fall from the first to the second value of their setting.
GROWN, PROVEN = (0.1, 0.4), (0.1, 0.6)
# Time after an onset during which samples are ignored [s]: the duration of the transient of valves
# and oil, which does not depend on the period of the motion.
PASSING = 0.06
# Number of past sample blocks that are searched for the onset after an alarm: 0.5 s at 500 Hz.
BLOCKS = 25
# Time after its onset at which an unexplained change is reported, and time over which its errors
# are averaged [s]: about a stride and half a stride, to wait for the end of errors by a new motion.
PATIENCE, RECENT = 1.3, 0.65
# Maximum number of faults whose maps are proposed after a fit: each map costs computing time.
CONTENDERS = 3
# Time after a case during which the map without any fault stays a contender [s], 2.5 strides:
# the map of a named fault only slowly learns the errors that the fault leaves unexplained.
AFTER = 3.0
# Time after an onset beyond which no map is proposed [s], because the learner has adapted by then.
LATE = 1.0
# Maximum number of persistent changes that are remembered: each adds a curve to the bank.
MOST_STANDING = 4
# Share of a change's learned shift that must disappear for the change to count as undone: the rest
# is then at most twice `DISCREPANCY`.
UNDONE = 0.7

# Slow wear.

# Number of looks (segments of samples, see `health`) that are judged together, because a single
# look may contain an unusual motion.
TOGETHER = 3
# Maximum number of looks whose sizes are kept; longer histories are thinned out.
MOST_LOOKS = 1024
# Minimum number of looks for a line; number of looks from which on only the later half is fitted,
# because a line through all looks underestimates accelerating wear.
FEWEST, MANY = 4, 16
# Probability that a value of a line lies outside its interval, on either side.
OUTSIDE = 0.1
