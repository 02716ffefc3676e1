"""Cycles of `bsnn_arx_bank` on a Cortex-M7.

Builds the controller of the whole leg with the monitor that names faults
(`tests/identification/microcontroller/leg.cc`: the same C++ core that the simulation runs, in
double precision) with the ARM compiler, runs it in an emulator
(Unicorn, which is QEMU's) and counts the instructions
that a control period executes, by kind. An emulator knows no cycles: they are an upper bound by
`CYCLES`, each instruction alone and none beside another, as from memory without wait states
(tightly coupled memory or warm caches). What the monitor finds there is held against what it finds
here.
"""

import argparse
import re
import shutil
import subprocess
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import results
from benchmarks.registry import ROOT
from leglab._native.monitor import Monitor
from leglab.control.feedforward.fault_bank import FaultBank, FaultCurve
from leglab.control.feedforward.fault_monitor import MonitorConfiguration
from leglab.control.feedforward.inverse_map import InverseMap
from leglab.control.feedforward.judge import judge
from leglab.control.feedforward.motion import smoothing_kernel
from leglab.control.feedforward.thresholds import BLOCKS, PASSING
from leglab.controllers.bsnn_arx import AdaptiveConfiguration
from leglab.runs.fault_simulation import cases

# What the emulator calls beside `setup`, and parts of the monitor.
_MONITOR = {
    "take_block": "takes a block of five samples (every tenth period)",
    "sum_sample": "sums a sample of an open case",
    "begin_look": "begins a look",
    "fit_curve": "fits one curve of a look",
    "find": "the odds of all, after a look",
}
_CALLED = ("plant", "period", *_MONITOR)

COMPILER = "arm-none-eabi-g++"
START = 0x10000  # address of the program
FLAGS = [
    "-std=c++20", "-O3", "-mcpu=cortex-m7", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv5-d16",
    "-ffreestanding", "-fno-exceptions", "-fno-rtti", "-fno-threadsafe-statics", "-Wall",
    "-Wextra", "--specs=nosys.specs", "-nostartfiles", "-Wl,--gc-sections",
    *(f"-Wl,-u,{name}" for name in _CALLED), "-Wl,-e,setup",
    f"-Wl,-Ttext={START:#x}", "-Wl,--no-warn-rwx-segments",
]  # fmt: skip
JOINTS, CLOCK, RATE = 6, 400e6, 500.0  # Hz, Hz
# Control periods, those that are not counted, and the one at which the machine changes.
PERIODS, SETTLED, FAULT_AT = 600, 200, 330
# Of the monitor: learned samples in a block; samples of an open case that are summed up and curves
# of a look that are fitted in a period that does not learn.
BLOCK, SUMMED, FITTED = 5, 2, 2
MOST_CURVES, MOST_NODES = 128, 8  # as in the program

# Cycles of an instruction from its start until its result can be used: those that LLVM schedules
# double precision by (ARMScheduleM7.td, llvm.org), and choices on the safe side for the rest. Every
# instruction counts in full, as if it waited for the one before: the core does two at a time.
CYCLES = {
    "division, square root": 30.0,
    "multiply and add": 11.0,
    "multiply": 7.0,
    "add, compare, convert": 4.0,
    "move of floats": 3.0,
    "load, store": 2.0,
    "further words of them": 1.0,
    "branch": 3.0,
    "integer division": 12.0,
    "integer": 1.0,
}
_KINDS = (
    (r"v(div|sqrt)", "division, square root"),
    (r"v(fma|fms|fnma|fnms|mla|mls|nmla|nmls)", "multiply and add"),
    (r"vn?mul", "multiply"),
    (r"v(add|sub|cmp|cvt|neg|abs|sel|maxnm|minnm|rint)", "add, compare, convert"),
    (r"v(ldm|stm|push|pop|ldr|str)|ldm|stm|push|pop|ldr|str", "load, store"),
    (r"v", "move of floats"),
    (
        r"(b|bl|bx|blx|cbz|cbnz|tbb|tbh|b(eq|ne|cs|hs|cc|lo|mi|pl|vs|vc|hi|ls|ge|lt|gt|le|al))"
        r"(\.|$)",
        "branch",
    ),
    (r"[su]div", "integer division"),
)


def kinds(mnemonic: str, operands: str) -> Counter[str]:
    """Entries of `CYCLES` that an instruction takes."""
    name = next((name for pattern, name in _KINDS if re.match(pattern, mnemonic)), "integer")
    found = Counter([name])
    if name == "load, store":
        found["further words of them"] = _words(mnemonic, operands) - 1
    return found


def _words(mnemonic: str, operands: str) -> int:
    """Words that a load or store moves: registers in braces or one, a double is two."""
    listed = re.search(r"\{(.*)\}", operands)
    if not listed:
        return 2 if re.match(r"\s*d\d", operands) or mnemonic.startswith(("ldrd", "strd")) else 1
    count = 0
    for part in listed[1].split(","):
        ends = [int(n) for n in re.findall(r"\d+", part)]
        span = ends[-1] - ends[0] + 1 if len(ends) > 1 else 1
        count += span * (2 if "d" in part else 1)
    return count


class Machine:
    """The program in the emulator.

    Args:
        elf: The linked program.

    Attributes:
        counts: Instructions executed since it was cleared, by address of their basic block and
            its size.
    """

    def __init__(self, elf: Path) -> None:
        import unicorn
        from unicorn import arm_const as arm

        self._arm = arm
        self.symbols = _symbols(elf)
        self._kinds = _listing(elf)
        self._cpu = cpu = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB)
        cpu.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M7)
        cpu.mem_map(0, 0x400000)
        image = elf.with_suffix(".bin")
        _tool("objcopy", "-O", "binary", str(elf), str(image))
        cpu.mem_write(START, image.read_bytes())
        self._end = 0x3FF000
        self.counts: Counter[tuple[int, int]] = Counter()
        cpu.hook_add(unicorn.UC_HOOK_BLOCK, self._count)

    def _count(self, _cpu: Any, address: int, size: int, _user: Any) -> None:
        self.counts[address, size] += 1

    def call(self, name: str) -> None:
        """Calls a function without arguments."""
        cpu, arm = self._cpu, self._arm
        cpu.reg_write(arm.UC_ARM_REG_SP, 0x3F0000)
        cpu.reg_write(arm.UC_ARM_REG_LR, self._end | 1)
        cpu.emu_start(self.symbols[name] | 1, self._end)

    def write(self, name: str, values: Any, kind: str = "<f8") -> None:
        """Writes numbers, by default doubles, to a variable."""
        content = np.asarray(values, dtype=kind).tobytes()
        self._cpu.mem_write(self.symbols[name], content)

    def unsigned(self, name: str) -> int:
        """A variable."""
        return int.from_bytes(self._cpu.mem_read(self.symbols[name], 4), "little")

    def number(self, name: str) -> float:
        """A variable."""
        return float(self.numbers(self.symbols[name], 1)[0])

    def numbers(self, address: int, count: int) -> np.ndarray:
        """Doubles from an address on."""
        return np.frombuffer(self._cpu.mem_read(address, 8 * count), dtype="<f8")

    def executed(self) -> Counter[str]:
        """Instructions by kind since `counts` was cleared."""
        found: Counter[str] = Counter()
        for (address, size), times in self.counts.items():
            for at in range(address, address + size, 2):
                for name, count in self._kinds.get(at, Counter()).items():
                    found[name] += times * count
        return found


def build(folder: Path) -> Path:
    """Compiles and links the program."""
    if shutil.which(COMPILER) is None:
        raise SystemExit(f"needs {COMPILER} (gcc-arm-none-eabi, libstdc++-arm-none-eabi-newlib)")
    elf = folder / "leg.elf"
    source = ROOT / "tests" / "identification" / "microcontroller" / "leg.cc"
    include = f"-I{ROOT / 'leglab' / 'csrc'}"
    done = subprocess.run(
        [COMPILER, *FLAGS, include, str(source), "-o", str(elf)],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise SystemExit(done.stderr)
    return elf


def _tool(name: str, *words: str) -> str:
    tool = COMPILER.replace("g++", name)
    return subprocess.run([tool, *words], capture_output=True, text=True, check=True).stdout


def _symbols(elf: Path) -> dict[str, int]:
    rows = (line.split() for line in _tool("nm", str(elf)).splitlines())
    return {row[2]: int(row[0], 16) & ~1 for row in rows if len(row) == 3}


def _listing(elf: Path) -> dict[int, Counter[str]]:
    """Kinds of operations of the instruction at every address."""
    found = {}
    for line in _tool("objdump", "-d", "--no-show-raw-insn", str(elf)).splitlines():
        match = re.match(r"\s*([0-9a-f]+):\t(\S+)\s*(.*)", line)
        if match:
            found[int(match[1], 16)] = kinds(match[2], match[3])
    return found


def measure(_options: argparse.Namespace) -> dict[str, Any]:
    """Instructions and cycles of a period and of the monitor's parts, and memory."""
    with tempfile.TemporaryDirectory() as folder:
        elf = build(Path(folder))
        sizes = _tool("size", str(elf)).splitlines()[1].split()
        machine = Machine(elf)
        config = AdaptiveConfiguration()
        inverse_map = InverseMap(
            JOINTS,
            config.rls,
            velocity_splines=config.velocity_splines,
            position_splines=config.position_splines,
            least_memory=config.least_memory,
        )
        shape = inverse_map.settings
        machine.write("kernel", smoothing_kernel(config.window, 1 / RATE))
        machine.write("velocity_knots", shape.features[0].basis.knots)  # type: ignore[union-attr]
        machine.write("position_knots", shape.features[1].basis.knots)  # type: ignore[union-attr]
        machine.write("prior", [2 / (s.upper - s.lower) for s in shape.inputs])
        machine.write("forgetting_factor", [shape.rls.forgetting_factor])
        bank = bank_of(inverse_map.learner().parameters.shape[-1])
        _hand_over(machine, bank)
        machine.call("setup")
        rows, errors, differences = _run(machine, bank, config.interval)
        if machine.unsigned("late_bytes"):
            raise SystemExit("memory was taken after the setup")
    nodes = sum(len(curve.sizes) - 1 for curve in bank.curves)
    found: dict[str, Any] = {
        "parameters": machine.unsigned("parameters"),
        "learner_bytes": machine.unsigned("learner_bytes"),
        "heap_bytes": machine.unsigned("heap_bytes"),
        "monitor_bytes": machine.unsigned("monitor_bytes"),
        "curves": len(bank.curves),
        "sizes": nodes,
        "code_bytes": int(sizes[0]),
        "first_error": float(np.mean(errors[20:60])),
        "last_error": float(np.mean(errors[FAULT_AT - 100 : FAULT_AT])),
        "looks": len(differences),
        "difference": max(differences),
    }
    for name, counts in rows.items():
        worst = max(counts, key=_cycles)
        found[name] = {
            "instructions": max(_instructions(c) for c in counts),
            "cycles": _cycles(worst),
            "kinds": {key: worst[key] for key in CYCLES},
            "mean_cycles": float(np.mean([_cycles(c) for c in counts])),
        }
    return found


def bank_of(parameters: int) -> FaultBank:
    """A bank of the leg's dimensions: all faults, elements and sizes, with made-up shifts."""
    rng = np.random.default_rng(1)
    curves = []
    for cause, element, side in cases(tuple(f"joint_{j}" for j in range(JOINTS))):
        healthy = cause.healthy_magnitude()
        sizes = np.array([healthy, *cause.magnitudes(side.bank, healthy)])
        shifts = 0.05 * rng.standard_normal((len(sizes), JOINTS, parameters)).astype(np.float32)
        shifts[0] = 0.0
        shifts = shifts.astype(float)
        curves.append(
            FaultCurve(fault=cause.name, element=element, meaning="", sizes=sizes, shifts=shifts)
        )
    return FaultBank(curves=tuple(curves))


def _hand_over(machine: Machine, bank: FaultBank) -> None:
    """Writes a bank to the program."""
    sizes = np.zeros((MOST_CURVES, MOST_NODES))
    for row, curve in zip(sizes, bank.curves, strict=False):
        row[: len(curve.sizes)] = curve.sizes
    machine.write("bank_sizes", sizes)
    machine.write("bank_nodes", [len(curve.sizes) for curve in bank.curves])
    machine.write("bank_group", bank.group, "<i4")
    machine.write("bank_curves", [len(bank.curves)], "<u4")
    machine.write("bank_keys", [len(bank.keys)], "<u4")
    machine.write("bank_shifts", np.concatenate([c.shifts[1:] for c in bank.curves]), "<f4")


class _Twin:
    """The monitor on this machine, with the samples of the emulated one."""

    def __init__(self, machine: Machine, bank: FaultBank) -> None:
        self._machine, self._bank = machine, bank
        self._shape = JOINTS, machine.unsigned("parameters")
        config = {**MonitorConfiguration().model_dump(), "slow_window": 100}
        numbers = {"sample_period": 2 / RATE, "passing": PASSING, "blocks": BLOCKS}
        self.core = Monitor(*self._shape, {**config, **numbers, "most_samples": BLOCK})
        self.core.reset(150)

    def take(self) -> None:
        joints, parameters = self._shape
        machine = self._machine
        place = machine.unsigned("block_samples")
        rows = machine.numbers(place, BLOCK * joints * (parameters + 3))
        learned = machine.numbers(machine.symbols["block_parameters"], joints * parameters)
        self.core.take(
            machine.number("time_now"),
            rows.reshape(BLOCK, joints, -1),
            learned.reshape(joints, parameters),
        )

    def look(self) -> None:
        discrepancy = MonitorConfiguration().discrepancy
        self._fit = self._bank.fit(self.core.look(), self.core.normal(), discrepancy)

    def difference(self) -> float:
        """Of the findings of both, the largest against their own size or the cost without."""
        fit = self._fit
        judged = judge(self._bank, [fit], MonitorConfiguration())
        best = judged.best
        named = fit.size[best], fit.spread[best], fit.cost[best]
        chance = judged.chance[self._bank.group[best]]
        here = np.array([best, *named, fit.without, fit.noise, chance])
        there = self._machine.numbers(self._machine.symbols["found"], 7)
        scale = np.abs(here)
        scale[3] = here[4]  # what is left is a difference
        return float(np.max(np.abs(here - there) / np.maximum(scale, 1e-3)))


def _run(
    machine: Machine, bank: FaultBank, interval: int
) -> tuple[dict[str, list[Counter[str]]], list[float], list[float]]:
    """Counts of every part, errors of the model, and how far the monitors' findings differ."""
    names = ("learns", "between", *_MONITOR)
    rows: dict[str, list[Counter[str]]] = {name: [] for name in names}
    errors, differences = [], []
    twin = _Twin(machine, bank)
    looking = False

    def call(name: str, kind: str) -> None:
        machine.counts.clear()
        machine.call(name)
        rows[kind].append(machine.executed())

    for k in range(PERIODS):
        if k == FAULT_AT:
            machine.write("plant_gain", [0.5])
        machine.call("plant")
        # Every second period learns; the counter of the controller starts at 1.
        learns = k % interval == interval - 1
        call("period", "learns" if learns else "between")
        errors.append(machine.number("last_error"))
        if learns:
            continue
        if machine.unsigned("kept") == BLOCK:
            call("take_block", "take_block")
            twin.take()
        if not machine.unsigned("case_open"):
            continue
        for _ in range(SUMMED):
            waits = not twin.core.sum(0)
            machine.counts.clear()
            machine.call("sum_sample")
            twin.core.sum(1)
            if waits:
                rows["sum_sample"].append(machine.executed())
        if not looking and machine.number("time_now") > machine.number("onset") + 0.09:
            call("begin_look", "begin_look")
            twin.look()
            looking = True
        for _ in range(FITTED if looking else 0):
            call("fit_curve", "fit_curve")
            if machine.unsigned("look_done"):
                call("find", "find")
                differences.append(twin.difference())
                looking = False
                break
    for name in ("learns", "between"):
        rows[name] = rows[name][SETTLED // interval :]
    return rows, errors, differences


def _instructions(counts: Counter[str]) -> int:
    return sum(counts.values()) - counts["further words of them"]


def _cycles(counts: Counter[str]) -> float:
    return sum(CYCLES[key] * count for key, count in counts.items())


def tables(kept: dict[str, Any]) -> str:
    """Periods with learning and without, worst ones; the monitor's parts; memory."""

    def numbers(instructions: float, *cycles: float) -> list[str]:
        counts = (instructions, *cycles, cycles[-1] / JOINTS)
        return [*(f"{n:,.0f}" for n in counts), f"{100 * cycles[-1] * RATE / CLOCK:.0f} %"]

    shares = ["a joint", "of 2 ms at 400 MHz"]
    head = ["period of six joints", "instructions", "cycles at most", *shares, *CYCLES]
    learns, between = kept["learns"], kept["between"]
    rows = []
    for own, label in ((learns, "learns (every second)"), (between, "does not")):
        by_kind = [f"{own['kinds'][key]:,.0f}" for key in CYCLES]
        rows.append([label, *numbers(own["instructions"], own["cycles"]), *by_kind])
    means = (0.5 * (learns[key] + between[key]) for key in ("instructions", "cycles"))
    rows.append(["mean", *numbers(*means), *[""] * len(CYCLES)])
    cost = ["cycles an instruction", "", "", "", "", *(f"{c:g}" for c in CYCLES.values())]
    parts = [
        [label, *numbers(*(kept[name][key] for key in ("instructions", "cycles", "mean_cycles")))]
        for name, label in _MONITOR.items()
    ]
    part_head = ["monitor", "instructions", "cycles at most", "in the mean", *shares]
    memory = [
        [f"learners, {JOINTS} of {kept['parameters']} parameters",
         f"{JOINTS * kept['learner_bytes'] / 1024:.0f}"],
        ["windows, tables, settings", f"{kept['heap_bytes'] / 1024:.0f}"],
        ["monitor: half a second of samples, two sums", f"{kept['monitor_bytes'] / 1024:.0f}"],
        ["flash: code and constants", f"{kept['code_bytes'] / 1024:.0f}"],
        [f"flash: bank of {kept['curves']} curves, {kept['sizes']} sizes, in single precision",
         f"{4 * kept['sizes'] * JOINTS * kept['parameters'] / 1024:.0f}"],
    ]  # fmt: skip
    learned = (
        "Mean error of the model, a joint, in share of full speed: "
        f"{kept['first_error'] / JOINTS:.2g} in the first 0.1 s of learning, "
        f"{kept['last_error'] / JOINTS:.2g} before the machine changes. What the monitor finds "
        f"there differs by {kept['difference']:.1g} from what it finds here."
    )
    counted = results.table(head, [*rows, cost])
    monitored = results.table(part_head, parts)
    return "\n".join([counted, monitored, results.table(["memory", "KiB"], memory), learned])
