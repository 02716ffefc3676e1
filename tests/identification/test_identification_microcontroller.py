"""The core compiles without heap, exceptions or an operating system."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent / "microcontroller" / "check.sh"


needs_compiler = pytest.mark.skipif(
    shutil.which("arm-none-eabi-g++") is None,
    reason="apt-get install -y gcc-arm-none-eabi libstdc++-arm-none-eabi-newlib",
)


@needs_compiler
def test_core_compiles_for_a_microcontroller():
    done = subprocess.run([SCRIPT], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow("a compilation and an emulator")
@needs_compiler
def test_the_whole_leg_builds_and_learns_on_a_cortex_m7():
    """Runs in an emulator where there is one; a period of six joints has 800,000 cycles."""
    pytest.importorskip("unicorn")
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", "microcontroller"],
        capture_output=True, text=True, check=False, cwd=Path(__file__).parents[2],
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    kept = {line.split(" | ")[0]: line for line in done.stdout.splitlines()}
    assert "| learners, 6 of 47 parameters" in kept
    mean = int(kept["| mean"].split(" | ")[2].replace(",", ""))
    assert mean < 800_000
    line = next(line for line in done.stdout.splitlines() if line.startswith("Mean error"))
    first, last, differs = re.findall(r"(\d\.?\d*(?:e-\d+)?) (?:in|before|from)", line)
    assert float(last) < 0.5 * float(first)
    assert float(differs) < 1e-9
    sums = int(kept["| sums a sample of an open case"].split(" | ")[3].replace(",", ""))
    assert 2 * mean + sums < 1_600_000
