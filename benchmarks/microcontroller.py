"""Cycles of `bsnn_arx` on a Cortex-M7: `python benchmarks/microcontroller.py`.

Builds the controller of the whole leg (`tests/microcontroller/leg.cc`, the same C++ core that the
simulation runs, in double precision) with the ARM compiler, runs it in an emulator (Unicorn, which
is QEMU's) and counts the instructions that a control period executes, by kind. An emulator knows no
cycles: they are an upper bound by `CYCLES`, each instruction alone and none beside another, as from
memory without wait states (tightly coupled memory or warm caches).
"""

import argparse
import re
import shutil
import struct
import subprocess
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import results

from leglab.control.feedforward.inverse_map import InverseMap
from leglab.control.feedforward.motion import smoothing_kernel
from leglab.controllers.bsnn_arx import AdaptiveConfiguration

COMPILER = "arm-none-eabi-g++"
FLAGS = [
    "-std=c++20", "-O3", "-mcpu=cortex-m7", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv5-d16",
    "-ffreestanding", "-fno-exceptions", "-fno-rtti", "-fno-threadsafe-statics", "-Wall",
    "-Wextra", "--specs=nosys.specs", "-nostartfiles", "-Wl,--gc-sections",
    "-Wl,-u,plant,-u,period,-e,setup", "-Wl,-Ttext=0x10000", "-Wl,--no-warn-rwx-segments",
]  # fmt: skip
JOINTS, CLOCK, RATE = 6, 400e6, 500.0  # Hz, Hz
PERIODS, SETTLED = 600, 200

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
        cpu.mem_map(0, 0x200000)
        for address, content in _segments(elf):
            cpu.mem_write(address, content)
        self._end = 0x1FF000
        self.counts: Counter[tuple[int, int]] = Counter()
        cpu.hook_add(unicorn.UC_HOOK_BLOCK, self._count)

    def _count(self, _cpu: Any, address: int, size: int, _user: Any) -> None:
        self.counts[address, size] += 1

    def call(self, name: str) -> None:
        """Calls a function without arguments."""
        cpu, arm = self._cpu, self._arm
        cpu.reg_write(arm.UC_ARM_REG_SP, 0x1F0000)
        cpu.reg_write(arm.UC_ARM_REG_LR, self._end | 1)
        cpu.emu_start(self.symbols[name] | 1, self._end)

    def write(self, name: str, values: Any) -> None:
        """Writes doubles to a variable."""
        content = np.asarray(values, dtype="<f8").tobytes()
        self._cpu.mem_write(self.symbols[name], content)

    def unsigned(self, name: str) -> int:
        """A variable."""
        return int(struct.unpack("<I", self._cpu.mem_read(self.symbols[name], 4))[0])

    def number(self, name: str) -> float:
        """A variable."""
        return float(struct.unpack("<d", self._cpu.mem_read(self.symbols[name], 8))[0])

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
    source = results.ROOT / "tests" / "microcontroller" / "leg.cc"
    include = f"-I{results.ROOT / 'leglab' / 'csrc'}"
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
    """What the instruction at every address takes."""
    found = {}
    for line in _tool("objdump", "-d", "--no-show-raw-insn", str(elf)).splitlines():
        match = re.match(r"\s*([0-9a-f]+):\t(\S+)\s*(.*)", line)
        if match:
            found[int(match[1], 16)] = kinds(match[2], match[3])
    return found


def _segments(elf: Path) -> list[tuple[int, bytes]]:
    """What is loaded, by address; from the program headers of the 32-bit ELF file."""
    content = elf.read_bytes()
    (start,) = struct.unpack_from("<I", content, 28)
    size, count = struct.unpack_from("<HH", content, 42)
    found = []
    for i in range(count):
        kind_, at, address, _, length = struct.unpack_from("<5I", content, start + i * size)
        if kind_ == 1 and length:
            found.append((address, content[at : at + length]))
    return found


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Instructions and cycles of a period, with learning and without, and memory."""
    with tempfile.TemporaryDirectory() as folder:
        elf = build(Path(folder))
        sizes = _tool("size", str(elf)).splitlines()[1].split()
        machine = Machine(elf)
        config = AdaptiveConfiguration()
        shape = InverseMap(
            JOINTS,
            config.rls,
            velocity_splines=config.velocity_splines,
            position_splines=config.position_splines,
            least_memory=config.least_memory,
        ).settings
        machine.write("kernel", smoothing_kernel(config.window, 4, 1 / RATE))
        machine.write("velocity_knots", shape.features[0].basis.knots)  # type: ignore[union-attr]
        machine.write("position_knots", shape.features[1].basis.knots)  # type: ignore[union-attr]
        machine.write("prior", [2 / (s.upper - s.lower) for s in shape.inputs])
        machine.write("forgetting_factor", [shape.rls.forgetting_factor])
        machine.call("setup")
        rows: dict[str, list[Counter[str]]] = {"learns": [], "between": []}
        errors = []
        for k in range(options.periods):
            machine.call("plant")
            machine.counts.clear()
            machine.call("period")
            errors.append(machine.number("last_error"))
            if k >= SETTLED:
                # Every second period learns; the counter of the controller starts at 1.
                rows["learns" if k % config.interval == config.interval - 1 else "between"].append(
                    machine.executed()
                )
    found: dict[str, Any] = {
        "parameters": machine.unsigned("parameters"),
        "learner_bytes": machine.unsigned("learner_bytes"),
        "heap_bytes": machine.unsigned("heap_bytes"),
        "code_bytes": int(sizes[0]),
        "first_error": float(np.mean(errors[20:60])),
        "last_error": float(np.mean(errors[-100:])),
    }
    for name, counts in rows.items():
        worst = max(counts, key=_cycles)
        found[name] = {
            "instructions": max(_instructions(c) for c in counts),
            "cycles": _cycles(worst),
            "kinds": {key: worst[key] for key in CYCLES},
        }
    return found


def _instructions(counts: Counter[str]) -> int:
    return sum(counts.values()) - counts["further words of them"]


def _cycles(counts: Counter[str]) -> float:
    return sum(CYCLES[key] * count for key, count in counts.items())


def tables(kept: dict[str, Any]) -> str:
    """Periods with learning and without, worst ones; then memory."""
    budget = CLOCK / RATE
    head = [
        "period of six joints",
        "instructions",
        "cycles at most",
        "a joint",
        "of 2 ms at 400 MHz",
    ]
    head += list(CYCLES)
    rows = []
    for name, label in (("learns", "learns (every second)"), ("between", "does not")):
        own = kept[name]
        rows.append(
            [
                label,
                f"{own['instructions']:,.0f}",
                f"{own['cycles']:,.0f}",
                f"{own['cycles'] / JOINTS:,.0f}",
                f"{100 * own['cycles'] / budget:.0f} %",
                *(f"{own['kinds'][key]:,.0f}" for key in CYCLES),
            ]
        )
    mean = 0.5 * (kept["learns"]["cycles"] + kept["between"]["cycles"])
    number = 0.5 * (kept["learns"]["instructions"] + kept["between"]["instructions"])
    share = f"{100 * mean / budget:.0f} %"
    rows.append(["mean", f"{number:,.0f}", f"{mean:,.0f}", f"{mean / JOINTS:,.0f}", share])
    rows[-1] += [""] * len(CYCLES)
    cost = ["cycles an instruction", "", "", "", "", *(f"{c:g}" for c in CYCLES.values())]
    memory = [
        [f"learners, {JOINTS} of {kept['parameters']} parameters",
         f"{JOINTS * kept['learner_bytes'] / 1024:.0f}"],
        ["the rest: windows, tables, settings", f"{kept['heap_bytes'] / 1024:.0f}"],
        ["code and constants (flash)", f"{kept['code_bytes'] / 1024:.0f}"],
    ]  # fmt: skip
    learned = (
        "Mean error of the model, a joint, in share of full speed: "
        f"{kept['first_error'] / JOINTS:.2g} in the first 0.1 s of learning, "
        f"{kept['last_error'] / JOINTS:.2g} at the end."
    )
    counted = results.table(head, [*rows, cost])
    return "\n".join([counted, results.table(["memory", "KiB"], memory), learned])


def main() -> None:
    """Measures, or prints what is kept."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--periods", type=int, default=PERIODS, help="control periods to run")
    results.main(parser, measure, tables)


if __name__ == "__main__":
    main()
