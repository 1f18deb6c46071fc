#!/bin/sh
# The compiler with Clippy's checks, of which every warning is an error. Cargo calls it for our own crates
# (RUSTC_WORKSPACE_WRAPPER). A separate `cargo clippy` would read all dependencies once more.
exec clippy-driver "$@" -D warnings
