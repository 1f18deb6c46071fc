#!/bin/sh
# Forbidden words in the code.
set -eu
cd "$(dirname "$0")/.."
deny() {
    if found=$(git grep -nE "$2" -- $3); then
        printf 'denied: %s\n%s\n' "$1" "$found"
        exit 1
    fi
}
deny 'fused multiply-add in physics: results would differ between machines' 'mul_add|fmadd|_fma|"fma"|\bfma\(' 'env/src'
deny 'maths of the platform in physics: use crate::real or libm' '\.(sin|cos|tan|exp|ln|powf|powi|sin_cos|log2|log10|cbrt|hypot|atan2)\(\)? *// *std' 'env/src'
deny 'a shared random generator or clock in the simulator' 'thread_rng|from_os_rng|rand::rng\(|SystemTime|Instant::now' 'env/src'
deny 'input or output in the simulator' 'std::fs|std::net|println!|eprintln!' 'env/src/*.rs env/src/effects env/src/task control/src'
deny 'unfinished code' 'todo!\(|unimplemented!\(|dbg!\(|FIXME' '*.rs *.py'
deny 'a fast-math or native target flag' 'target-cpu|ffast-math|fast-math' '*.toml .cargo'
echo 'deny list: clean'
