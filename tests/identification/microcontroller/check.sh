#!/bin/sh
# Compiles the identification core for a Cortex-M4 and fails if it needs more than the compiler's
# own arithmetic and memory helpers. Usage: check.sh [compiler]
set -eu
here=$(cd "$(dirname "$0")" && pwd)
compiler=${1:-arm-none-eabi-g++}
object=$(mktemp)
trap 'rm -f "$object"' EXIT
"$compiler" -std=c++20 -O2 -mcpu=cortex-m4 -mthumb -mfloat-abi=hard -mfpu=fpv4-sp-d16 \
  -ffreestanding -fno-exceptions -fno-rtti -fno-threadsafe-statics \
  -Wall -Wextra -Werror -Wdouble-promotion \
  -I"$here/../../../leglab/csrc" -c "$here/compile_check.cc" -o "$object"
# __aeabi_*: arithmetic in double and memory, both from libgcc; nothing of the C or C++ library
# but the four functions that every freestanding compiler may call.
foreign=$(${compiler%g++}nm --undefined-only "$object" | awk '{print $2}' |
  grep -Ev '^(__aeabi_.*|mem(cpy|move|set|cmp))$' || true)
if [ -n "$foreign" ]; then
  echo "the core needs symbols that a microcontroller may lack: $foreign" >&2
  exit 1
fi
${compiler%g++}size "$object"
