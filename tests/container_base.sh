#!/usr/bin/env bash
# Makes a stand-in for the official Rust image that the Dockerfile builds on, for machines that reach no image registry:
# Debian by debootstrap, the Rust toolchain of this machine, and what this machine needs to reach its crate registry.
#   tests/container_base.sh rust:1.95.0-slim-bookworm
set -euo pipefail
name="$1"
suite="${name##*-}"

container="$(buildah from scratch)"
trap 'buildah rm "$container" >/dev/null' EXIT
root="$(buildah mount "$container")"

# The packages that the official image adds to Debian, as far as a build needs them.
debootstrap --variant=minbase --include=ca-certificates,gcc,libc6-dev "$suite" "$root"
rm -rf "$root"/var/cache/apt/archives/*.deb "$root"/var/lib/apt/lists/*

sysroot="$(rustc --print sysroot)"
cp -a "$sysroot/bin" "$sysroot/lib" "$root/usr/local/"

# Certificates and settings of cargo that are peculiar to this machine; never its credentials.
cargo_home=/usr/local/cargo
mkdir -p "$root$cargo_home"
cp /etc/ssl/certs/ca-certificates.crt "$root/etc/ssl/certs/"
settings="${CARGO_HOME:-$HOME/.cargo}/config.toml"
[ ! -e "$settings" ] || cp "$settings" "$root$cargo_home/"
environment=(--env "CARGO_HOME=$cargo_home")
while read -r setting; do
    environment+=(--env "$setting")
done < <(env | grep -E '^CARGO_(HTTP|NET|SOURCE|REGISTRIES)_' | grep -v TOKEN || true)

buildah config "${environment[@]}" "$container"
buildah commit --quiet "$container" "docker.io/library/$name"
