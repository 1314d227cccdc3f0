#!/bin/sh
# Notes what it was started with and dies.
echo "$@" >>"$0.arguments"
echo "a first line"
echo "the ground gave way" >&2
exit 3
