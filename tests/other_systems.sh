#!/bin/sh
# Does the program compile for other systems? A check without linking: nothing is run. Its C parts are compiled by zig.
#   sh tests/other_systems.sh FOLDER
set -eu
folder=${1:?where the compiler goes, such as out/other_systems}
mkdir -p "$folder"
folder=$(cd "$folder" && pwd)
cd "$(dirname "$0")/.."
[ -x "$folder/venv/bin/python" ] || python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "ziglang>=0.15,<0.17"
# Rust's name of a system, and zig's
while read -r target zig; do
    rustup target add "$target" 2> /dev/null
    # callers use Rust's names of targets, which zig does not know
    cat > "$folder/cc-$target" <<END
#!/bin/sh
for given; do
    shift
    case "\$given" in --target=*) ;; *) set -- "\$@" "\$given" ;; esac
done
exec "$folder/venv/bin/python" -m ziglang cc -target $zig "\$@"
END
    cat > "$folder/ar" <<END
#!/bin/sh
exec "$folder/venv/bin/python" -m ziglang ar "\$@"
END
    chmod +x "$folder/cc-$target" "$folder/ar"
    name=$(echo "$target" | tr - _)
    env "CC_$name=$folder/cc-$target" "AR_$name=$folder/ar" PYO3_NO_PYTHON=1 RUSTFLAGS="-D warnings" \
        cargo check --quiet --workspace --target "$target" --target-dir "$folder/target"
    echo "$target: compiles"
done <<END
x86_64-pc-windows-gnu x86_64-windows-gnu
aarch64-apple-darwin aarch64-macos
aarch64-unknown-linux-gnu aarch64-linux-gnu
END
