"""Thresholds of live fault names and of slow wear, each with its reason.

Those that a user may set are defaults of `JudgeConfiguration`, `MonitorConfiguration` and
`HealthConfiguration`. Squared errors and sizes are ratios, valid for any machine. Times and numbers
of learned samples hold for a reference of period `STRIDE`, and scale with the period of another
one, except `PASSING`.
"""

# Period of the reference that times are given for [s].
STRIDE = 1.2

# Criteria of a name.

# Standard deviation of the share of the error that the true fault leaves, since no machine is the
# nominal one: two parts that differ from their data by a tenth each.
DISCREPANCY = 0.15
# Mean square error of a joint, over its normal value, above which a change affects the joint [1]:
# strides of a sound machine differ by less.
CHANGED = 2.0
# The same ratio, for the map before the change, above which an unexplained change is reported:
# about three times the RMS error, as there is no other evidence.
UNEXPLAINED = 10.0
# Faults within this factor of the most probable one are reported with it, at most this many in all:
# one name would hide that several fit the samples, and more names would be of no use.
ALIKE, TOLD = 4.0, 3
# Standard deviations from the middle to the ends of an interval of 90 %.
NINETY = 1.645
# Ridge penalty on the difference from the learner's parameters: the fitted map keeps them in the
# directions that the motion does not excite.
RIDGE = 1e-2

# Abrupt changes.

# Times after an onset at which the bank is fitted [s]: dense at first, as the evidence grows. A
# case ends at the last one, or once a name has been in force for `STEADY` [s], so that another
# change can be detected.
_EARLY = (0.09, 0.12, 0.15, 0.18, 0.22, 0.26, 0.3, 0.36, 0.43, 0.5, 0.6, 0.72, 0.86, 1.0)
LOOKS = (*_EARLY, 1.2, 1.4, 1.7, 2.0, 2.4, 2.8, 3.2)
STEADY = 2.0
# Times after an onset between which the required explained share (`GROWN`) and the required
# evidence of a name (`PROVEN`) fall from their first to their second value [s].
GROWN, PROVEN = (0.1, 0.4), (0.1, 0.6)
# Samples within this time of an onset are ignored [s]: the transient of valves and oil, which does
# not depend on the period of the motion.
PASSING = 0.06
# Past blocks that are kept to find the onset after an alarm: half a second at 500 Hz.
BLOCKS = 25
# Time after its onset at which an unexplained change is reported, and time over which its errors
# are averaged [s]: about a stride and half a stride, since a new motion causes errors for a moment.
PATIENCE, RECENT = 1.3, 0.65
# Most faults proposed at a look: each adds a map whose learning takes time of the control period.
CONTENDERS = 3
# Time after a case during which the map that was never corrected stays a contender [s], two strides
# and a half: the map of a named fault learns what the name leaves unexplained slowly.
AFTER = 3.0
# Time after an onset from which on no map is proposed [s]: the learner has adapted by then.
LATE = 1.0
# Most persistent changes: each adds a curve to the bank.
MOST_STANDING = 4
# Share of a change's learned shift that must disappear for it to count as undone: the rest is then
# at most twice `DISCREPANCY`.
UNDONE = 0.7

# Slow wear.

# Looks that are evaluated together: a single one may contain an unusual motion.
TOGETHER = 3
# Most looks whose sizes are kept: longer histories are thinned out.
MOST_LOOKS = 1024
# Fewest looks of a line; number of looks from which on only the later half is fitted, since a line
# through all of them underestimates accelerating wear.
FEWEST, MANY = 4, 16
# Probability outside the interval of a line, at both ends together.
OUTSIDE = 0.1
