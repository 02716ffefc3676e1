"""The core compiles without heap, exceptions or an operating system."""

import shutil
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent / "microcontroller" / "check.sh"


@pytest.mark.skipif(
    shutil.which("arm-none-eabi-g++") is None,
    reason="needs arm-none-eabi-g++ (packages gcc-arm-none-eabi, libstdc++-arm-none-eabi-newlib)",
)
def test_core_compiles_for_a_microcontroller():
    done = subprocess.run([SCRIPT], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
