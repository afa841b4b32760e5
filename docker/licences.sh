#!/bin/sh
# Prints the licence texts of everything that the binary contains: every crate that is linked, the parts that crates bring
# along (Swagger UI, SQLite), glibc and the Rust standard library. The parts under MPL-2.0 are named first, with the address
# of their source, as that licence asks. Each text stands once, below the names of the crates that have it. Needs cargo, the
# sources of the crates, which a build has fetched, and Debian's common licences; nothing is downloaded.
#   docker/licences.sh TARGET > third-party-licences.txt
set -eu
target="$1"
sources="${CARGO_HOME:-$HOME/.cargo}/registry/src"
common=/usr/share/common-licenses
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT

# Name, version and licence of every crate that is linked, one a line.
cargo tree --locked --offline --target "$target" --edges normal,no-proc-macro --prefix none --format '{p}|{l}' |
    sed 's/ (\*)$//; s/ ([^|]*)|/|/' | sed -n 's/^\([^ ]*\) v\([^|]*\)|\(.*\)$/\1 \2 \3/p' |
    grep -v '^coaxis[ -]' | sort -u >"$work/crates"

# Puts a text beside the names of those that have it.
note() { # name, text
    sum="$(cksum <"$2" | tr ' ' -)"
    cp "$2" "$work/$sum.text"
    echo "$1" >>"$work/$sum.names"
}

while read -r name version licence; do
    found=no
    # Fails where no registry has the crate; where two have it, either will do.
    for crate in "$sources"/*/"$name-$version"; do cd "$crate"; done
    # Code that a crate has taken over has its licence beside it, somewhere below src.
    find . -type f ! -name '*.rs' |
        grep -i -E '^\./(src/.*/)?(un)?(licen[cs]e|copying|copyright|notice)[^/]*$' >"$work/texts" || true
    while read -r text; do
        found=yes
        note "$name $version ($licence)" "$text"
    done <"$work/texts"
    if [ "$found" = no ]; then
        case "$licence" in
        *MPL-2.0*) note "$name $version ($licence)" "$common/MPL-2.0" ;;
        *Apache-2.0*) note "$name $version ($licence)" "$common/Apache-2.0" ;;
        *) echo "$name $version ($licence)" >>"$work/without" ;;
        esac
    fi
done <"$work/crates"
swagger_ui="Swagger UI, embedded by utoipa-swagger-ui (Apache-2.0)"
printf 'swagger-ui\nCopyright 2020-2021 SmartBear Software Inc.\n' >"$work/notice"
note "$swagger_ui" "$work/notice"
note "$swagger_ui" "$common/Apache-2.0"
note "the Rust standard library (MIT OR Apache-2.0)" "$common/Apache-2.0"
note "glibc, linked statically (LGPL-2.1-or-later)" "$common/LGPL-2.1"

echo "coaxis is licensed under MIT or Apache-2.0, at your option. Its binary contains the parts below under their own licences."
echo
echo "Under the Mozilla Public License 2.0, unchanged; the source of each is at the address beside it:"
echo
sed -n 's/^\([^ ]*\) \([^ ]*\) .*MPL-2\.0.*$/  \1 \2    https:\/\/crates.io\/crates\/\1\/\2/p' "$work/crates"
echo
echo "SQLite, compiled by libsqlite3-sys, is in the public domain."
echo
echo "glibc is linked statically. The source of coaxis and its Dockerfile are what is needed to link it with another glibc."
if [ -f "$work/without" ]; then
    echo
    echo "Without a text of their own, under the licence that is named:"
    echo
    sed 's/^/  /' "$work/without"
fi
for names in "$work"/*.names; do
    echo
    echo "================================================================================"
    sort -u "$names"
    echo "--------------------------------------------------------------------------------"
    cat "${names%.names}.text"
done
