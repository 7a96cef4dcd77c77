#!/bin/sh
# A C compiler that does not optimise, and that compiles no text twice: a mutant changes one file.
set -e
for last; do :; done
case "$*" in
*" -c "*)
    mkdir -p "$MUTANTS_OBJECTS"
    set -- "$@" -O0 -Dalways_inline=unused
    text=$(mktemp)
    cc "$@" -E -P -o "$text"
    kept=$MUTANTS_OBJECTS/$(cat "$text" | sha256sum | cut -d ' ' -f 1).o
    rm "$text"
    if ! [ -e "$kept" ]; then
        cc "$@" -o "$kept.$$"
        mv "$kept.$$" "$kept"
    fi
    cp "$kept" "$last"
    ;;
*) exec cc "$@" ;;
esac
