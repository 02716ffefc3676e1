"""Chosen numbers of names while driving and of slow wear, each with its reason.

Those that a user may set are defaults of `JudgeConfiguration`, `MonitorConfiguration` and
`HealthConfiguration`. Squared errors and sizes are ratios, of any machine. Times, and numbers of
learned samples, are those of a reference of period `STRIDE`: with another one they are longer or
shorter in proportion, but for `PASSING`.
"""

# Period of the reference that times are given for [s].
STRIDE = 1.2

# What is judged.

# Share of the error that a right fault leaves, since no machine is the nominal one; a deviation:
# two parts that differ from their data by a tenth each.
DISCREPANCY = 0.15
# Mean square error of a joint, over the normal one, from which on a change concerns it [1]: strides
# of a sound machine differ by less.
CHANGED = 2.0
# The same, of the map before the change, from which on a change that nothing explains is told:
# three times the RMS error, for there is no other evidence.
UNEXPLAINED = 10.0
# Faults within this factor of the most probable one are told with it, at most so many in all: what
# the samples do not tell apart is not told by one name, and more names say nothing.
ALIKE, TOLD = 4.0, 3
# Standard deviations from the middle to the ends of an interval of 90 %.
NINETY = 1.645
# Weight of a squared parameter about the learner's against the squared errors of the samples: the
# map stays where the motion does not show it.
RIDGE = 1e-2

# A change at once.

# Times after an onset at which the bank is asked [s]: often at first, as the evidence grows. The
# case is closed at the last one, or once a name has stood for `STEADY` [s]: the machine may change
# again.
_EARLY = (0.09, 0.12, 0.15, 0.18, 0.22, 0.26, 0.3, 0.36, 0.43, 0.5, 0.6, 0.72, 0.86, 1.0)
LOOKS = (*_EARLY, 1.2, 1.4, 1.7, 2.0, 2.4, 2.8, 3.2)
STEADY = 2.0
# From when to when after an onset an explanation may become less good, as more is seen, and the
# evidence for it and for its name less [s].
GROWN, PROVEN = (0.1, 0.4), (0.1, 0.6)
# Samples right after an onset do not count: valves and oil pass over to their new state [s],
# however slow the motion is.
PASSING = 0.06
# Blocks that are kept to look back at, from an alarm on: half a second at 500 Hz.
BLOCKS = 25
# How long after its onset a change that nothing explains is told, and over what time [s]: a stride
# of a leg and half of one, since a motion never made before may err for a moment.
PATIENCE, RECENT = 1.3, 0.65
# So many faults are proposed at a look: each is a map that learns, in the time of a period.
CONTENDERS = 3
# A named fault's map learns slowly what the name does not say: the one that was never corrected
# stays beside it for so long after the case [s], two strides and a half.
AFTER = 3.0
# What comes later corrects nothing: the learner has found its own way by then [s].
LATE = 1.0
# So many changes are remembered: each adds a curve to the bank.
MOST_STANDING = 4
# Share of what is learned of a change that must go for it to count as undone: what is left is then
# at most twice the doubt of a size.
UNDONE = 0.7

# Slow wear.

# Looks that are judged together: one alone may be of an odd motion.
TOGETHER = 3
# Looks whose sizes are kept: days are a coarser line.
MOST_LOOKS = 1024
# Looks on a line, at least; from so many on the later half of them is the line, since wear that
# grows faster and faster is shown too good by all.
FEWEST, MANY = 4, 16
# Both ends of an interval of a line together leave out so much.
OUTSIDE = 0.1
