#!/bin/sh
# The compiler of the tests, with Clippy's checks: cargo puts it before the compiler of our own crates
# (RUSTC_WORKSPACE_WRAPPER). What is checked and compiled at once needs no second reading of all dependencies.
exec clippy-driver "$@" -D warnings
