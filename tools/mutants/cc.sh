#!/bin/sh
# A C compiler that hardly optimises, and that compiles no text twice: a mutant changes one file.
# The last two arguments of a compilation are -o and the object.
set -e
case "$*" in
*" -c "*)
    count=$#
    for last; do
        shift
        [ $count -gt 2 ] && set -- "$@" "$last"
        count=$((count - 1))
    done
    set -- "$@" -O1
    mkdir -p "$MUTANTS_OBJECTS"
    kept=$MUTANTS_OBJECTS/$(cc "$@" -E -P | cat - "$0" | sha256sum | cut -d ' ' -f 1).o
    if ! [ -e "$kept" ]; then
        cc "$@" -o "$kept.$$"
        mv "$kept.$$" "$kept"
    fi
    cp "$kept" "$last"
    ;;
*) exec cc "$@" ;;
esac
