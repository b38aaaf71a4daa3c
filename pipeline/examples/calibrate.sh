#!/bin/sh
# From measured volume losses to constants, and from these to bands of the strength left.
# Cost: two and a half minutes of processor time, with one rate per node (--classes 0).  Left out of both
# commands, rate classes are taken, the default.
set -e
measured="$(dirname "$0")/measured.csv"

perilife calibrate --alloy Mg-5Gd --classes 0 --volume-loss "Mg-5Gd=$measured" --out fits/example

perilife run --alloy Mg-5Gd --immersion 8w 12w --parameters fits/example/parameters.toml \
    --samples 100 --classes 0 --volume-loss "Mg-5Gd=$measured" --out runs/bands
