#!/bin/sh
# rustdoc as cargo calls it (RUSTDOC) to run the examples in a crate's documentation. The documentation itself is written
# as well, and every warning is an error. `cargo doc` would read all dependencies once more for it.
set -eu
rustdoc "$@"
for word; do
    shift
    [ "$word" = --test ] || set -- "$@" "$word"
done
exec rustdoc "$@" -D warnings -o target/doc
