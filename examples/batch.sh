#!/usr/bin/env bash
# Registers recordings one after the other, measures those with a ground truth, and prints one table.
#
#   examples/batch.sh [-o DIR] [-c CONFIG] RECORDING...
#
# Results go to DIR/<name of the recording> (default: results). Messages go to stderr, the table to stdout.
# Exit status: 0 every recording was registered, 1 one or more were not, 2 wrong usage, 130 interrupted.
set -uo pipefail

out=results config=default
while getopts "o:c:h" option; do
  case "$option" in
    o) out=$OPTARG ;;
    c) config=$OPTARG ;;
    h) sed -n '2,7s/^# \{0,1\}//p' "$0"; exit 0 ;;
    *) exit 2 ;;
  esac
done
shift $((OPTIND - 1))
[ $# -gt 0 ] || { echo "usage: $0 [-o DIR] [-c CONFIG] RECORDING..." >&2; exit 2; }

# field JSON EXPRESSION: a value of a JSON object d, formatted by Python.
field() { python3 -c 'import json, sys; d = json.loads(sys.argv[1]); print(eval(sys.argv[2]))' "$1" "$2"; }

row="%-28s %11s %7s %8s %8s %8s %8s\n"
# shellcheck disable=SC2059
printf "$row" recording registered edges "ATE cm" "RPE deg" "RPE cm" seconds
failed=0
for recording in "$@"; do
  name=$(basename "$(realpath "$recording")")
  result=$out/$name
  summary=$(miniloop register "$recording" -o "$result" --config "$config" -q --json -)
  status=$?
  [ $status -eq 130 ] && exit 130
  if [ $status -ne 0 ]; then
    failed=1
    # shellcheck disable=SC2059
    printf "$row" "$name" failed - - - - -
    continue
  fi
  ate=- deg=- cm=-
  if errors=$(miniloop eval "$result" --gt "$recording" --json - 2> >(grep -v "without ground truth" >&2)); then
    ate=$(field "$errors" '"%.2f" % (100 * d["ate_rmse_m"])')
    deg=$(field "$errors" '"%.2f" % d["rpe"]["edges"]["rot_deg_mean"]')
    cm=$(field "$errors" '"%.2f" % (100 * d["rpe"]["edges"]["trans_m_mean"])')
  fi
  # shellcheck disable=SC2059
  printf "$row" "$name" "$(field "$summary" '"%d/%d" % (d["registered"], d["frames"])')" \
    "$(field "$summary" 'd["edges"]')" "$ate" "$deg" "$cm" \
    "$(field "$summary" '"%.1f" % sum(d["timings_s"].values())')"
done
exit $failed
