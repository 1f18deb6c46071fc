#!/bin/sh
# The wheel for 64-bit ARM, made on another processor and tried in an emulator: it must fly the same bits as the wheel of
# this machine. Needs Debian or Ubuntu, root and its package qemu-user-static; takes the folder of the virtual
# environment, and a folder for the wheel.
set -eu
BIN=$(cd "$1" && pwd)
OUT=$2
SOURCE=$(pwd)
command -v qemu-aarch64-static > /dev/null || { echo "no emulator: apt-get install qemu-user-static"; exit 1; }
rm -rf "$OUT"
mkdir -p "$OUT/packages" "$OUT/wheels"
OUT=$(cd "$OUT" && pwd)
rustup target add aarch64-unknown-linux-gnu
"$BIN/uv" pip install --quiet --python "$BIN/python" "maturin[zig]>=1.16,<2" "auditwheel>=6.8" "twine>=6"
PATH="$BIN:$PATH" "$BIN/maturin" build --release --zig --target aarch64-unknown-linux-gnu \
    --compatibility manylinux_2_28 --out "$OUT"
wheel=$(ls "$OUT"/*-cp310-abi3-manylinux_2_28_aarch64.whl)
"$BIN/python" -m twine check --strict "$wheel"
# a Python of the other processor, in a folder of its own
dpkg --add-architecture arm64
apt-get update --quiet
cd "$OUT/packages"
version=$(apt-cache depends python3 | sed -n 's/.*Depends: python3\.\([0-9]*\)$/\1/p')
for package in libc6 libgcc-s1 libstdc++6 libgomp1 zlib1g libexpat1 libffi8 libssl3 libbz2-1.0 liblzma5 libsqlite3-0 \
    libcrypt1 libuuid1 "libpython3.$version-minimal" "libpython3.$version-stdlib" "python3.$version-minimal"; do
    apt-get download --quiet "$package:arm64"
done
for package in *.deb; do dpkg -x "$package" "$OUT/root"; done
"$BIN/pip" download --quiet --dest "$OUT/wheels" --only-binary=:all: --python-version "3$version" \
    --platform manylinux_2_28_aarch64 --platform manylinux_2_17_aarch64 "$wheel"
for part in "$OUT"/wheels/*.whl; do "$BIN/python" -m zipfile -e "$part" "$OUT/site"; done
emulated() {
    PYTHONPATH="$OUT/site" qemu-aarch64-static -L "$OUT/root" "$OUT/root/usr/bin/python3.$version" "$@"
}
emulated "$SOURCE/tests/bits.py" > "$OUT/there.txt"
"$BIN/python" "$SOURCE/tests/bits.py" > "$OUT/here.txt"
diff "$OUT/here.txt" "$OUT/there.txt"
emulated -m crazyflie_gym fly --task fly-80cm
echo "$(basename "$wheel"): $(wc -c < "$wheel") bytes; $(wc -l < "$OUT/here.txt") kinds of flights have the same bits"
