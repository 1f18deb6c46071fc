#!/bin/sh
# The wheel as it is released: for every Python from 3.10 on and every Linux from glibc 2.28 on, and working in an
# environment that has nothing else. Takes the folder of the virtual environment, and a folder for the wheel.
set -eu
BIN=$1
OUT=$2
# 5 % over its size of 29 November 2026, so that it grows only on purpose
MOST_BYTES=13600000
SOURCE=$(pwd)
"$BIN/uv" pip install --quiet --python "$BIN/python" "maturin[zig]>=1.16,<2" "auditwheel>=6.8" "twine>=6"
rm -rf "$OUT"
# zig links against the old glibc on any machine
PATH="$BIN:$PATH" "$BIN/maturin" build --release --zig --compatibility manylinux_2_28 --out "$OUT"
wheel=$(ls "$OUT"/*.whl)
case $wheel in
    *-cp310-abi3-manylinux_2_28_*.whl) ;;
    *) echo "$wheel: expected abi3 from Python 3.10 on and the tag manylinux_2_28"; exit 1 ;;
esac
bytes=$(wc -c < "$wheel")
[ "$bytes" -lt "$MOST_BYTES" ] || { echo "$wheel has $bytes bytes, expected less than $MOST_BYTES"; exit 1; }
"$BIN/auditwheel" show "$wheel" | tee "$OUT/audit.txt"
grep -Eq 'manylinux_2_(1[0-9]|2[0-8]|5)_' "$OUT/audit.txt" || { echo "auditwheel finds a newer glibc than 2.28"; exit 1; }
"$BIN/python" -m twine check --strict "$wheel"
"$BIN/python" -m venv "$OUT/clean"
"$OUT/clean/bin/python" -m pip install --quiet "$wheel[jax]"
cd "$OUT"
# no compiler: what is called is what came with the wheel
PATH="$OUT/clean/bin:/usr/bin:/bin"
crazyflie --version
python "$SOURCE/examples/6_close_the_loop.py" | tee explained.txt
grep -q "lacks drag_linear" explained.txt
for task in "$SOURCE"/examples/tasks/*.toml; do crazyflie fly --task "$task" --runs 2 > /dev/null; done
python "$SOURCE/tests/wheel.py"
echo "$(basename "$wheel"): $bytes bytes"
