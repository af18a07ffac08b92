#!/usr/bin/env bash
# Fetch sequences of the TUM RGB-D benchmark: resumes, verifies, extracts once, may be run again at any time.
#
#   scripts/fetch_tum.sh                          # the paper's three: freiburg1_room freiburg1_xyz freiburg2_desk
#   scripts/fetch_tum.sh freiburg1_desk           # by name
#   scripts/fetch_tum.sh --subset 100             # also <name>_100: 100 evenly spaced frames
#   scripts/fetch_tum.sh -d ~/tum --list          # where to; which names there are
#
# MINILOOP_TUM_URL replaces the server, e.g. by a mirror or file:///some/folder with the .tgz files.
# Data: J. Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems", IROS 2012; CC BY 4.0.
set -euo pipefail

readonly DEFAULT_URL="https://cvg.cit.tum.de/rgbd/dataset"
readonly PAPER=(freiburg1_room freiburg1_xyz freiburg2_desk)
readonly KNOWN=(
  freiburg1_360 freiburg1_desk freiburg1_desk2 freiburg1_floor freiburg1_plant freiburg1_room freiburg1_rpy
  freiburg1_teddy freiburg1_xyz freiburg2_360_hemisphere freiburg2_360_kidnap freiburg2_coke freiburg2_desk
  freiburg2_desk_with_person freiburg2_dishes freiburg2_flowerbouquet freiburg2_large_no_loop
  freiburg2_large_with_loop freiburg2_metallic_sphere freiburg2_rpy freiburg2_xyz freiburg3_cabinet
  freiburg3_large_cabinet freiburg3_long_office_household freiburg3_nostructure_texture_far
  freiburg3_nostructure_texture_near_withloop freiburg3_sitting_halfsphere freiburg3_sitting_static
  freiburg3_sitting_xyz freiburg3_structure_notexture_far freiburg3_structure_texture_far
  freiburg3_structure_texture_near freiburg3_teddy freiburg3_walking_halfsphere freiburg3_walking_static
  freiburg3_walking_xyz
)

folder="data/tum"
subset=0
names=()

say() { printf 'fetch_tum: %s\n' "$*" >&2; }
fail() { say "$*"; exit 1; }
usage() { sed -n '2,11s/^# \{0,1\}//p' "$0"; }

while (($#)); do
  case "$1" in
    -h | --help) usage; exit 0 ;;
    --list) printf '%s\n' "${KNOWN[@]}"; exit 0 ;;
    -d | --dir) folder="${2:?"$1 needs a folder"}"; shift 2 ;;
    --subset) subset="${2:?"--subset needs a number of frames"}"; shift 2 ;;
    -*) say "unknown option $1"; usage >&2; exit 2 ;;
    *) names+=("${1#rgbd_dataset_}"); shift ;;
  esac
done
[[ $subset =~ ^[0-9]{1,6}$ ]] || { say "--subset needs a number of frames, not '$subset'"; exit 2; }
((${#names[@]})) || names=("${PAPER[@]}")
for name in "${names[@]}"; do
  [[ $name =~ ^freiburg([123])_[a-z0-9_]+$ ]] || {
    say "'$name' is no sequence of the benchmark; --list shows them"
    exit 2
  }
done

url="${MINILOOP_TUM_URL:-$DEFAULT_URL}"
mkdir -p "$folder" || fail "cannot write to $folder; choose another with -d"

# Download $1 to $2, continuing what an interrupted run left (from the start where the server cannot continue).
download() {
  if command -v curl >/dev/null; then
    local options=(--fail --location --retry 3 --connect-timeout 20 --progress-bar --output "$2") status=0
    curl "${options[@]}" --continue-at - "$1" || status=$?
    if ((status == 33 || status == 36)); then
      status=0
      curl "${options[@]}" "$1" || status=$?
    fi
    return "$status"
  elif command -v wget >/dev/null; then
    wget --continue --tries=3 --timeout=20 --output-document="$2" "$1"
  else
    fail "neither curl nor wget is installed"
  fi
}

# The archive is whole and holds nothing that would be extracted elsewhere.
sound() {
  local listing
  gzip -t -- "$1" 2>/dev/null && listing=$(tar -tzf "$1" 2>/dev/null) &&
    ! grep -qE '^/|(^|/)\.\.(/|$)' <<<"$listing" && grep -q "^\(\./\)\?rgbd_dataset_$2/rgb.txt$" <<<"$listing"
}

complete() { [[ -f $1/rgb.txt && -f $1/depth.txt && -d $1/rgb && -d $1/depth ]]; }

fetch() {
  local name="$1" target="$folder/rgbd_dataset_$1" archive="$folder/rgbd_dataset_$1.tgz"
  if complete "$target"; then
    say "$name is there: $target"
    return
  fi
  if [[ ! -f $archive ]]; then
    local source="$url/freiburg${name:8:1}/rgbd_dataset_$name.tgz"
    say "fetching $source"
    if ! sound "$archive.part" "$name" && ! download "$source" "$archive.part"; then
      local had=""
      [[ -s $archive.part ]] && had="; what came is kept, the same command continues"
      fail "could not fetch $source (no network, or no such sequence? --list shows the names)$had"
    fi
    if ! sound "$archive.part" "$name"; then
      rm -f -- "$archive.part"
      fail "$source came damaged and was removed; run the same command again"
    fi
    mv -- "$archive.part" "$archive"
  elif ! sound "$archive" "$name"; then
    fail "$archive is damaged; remove it and run the same command again"
  fi
  say "extracting $name"
  local temporary="$folder/.extract_$name.$$"
  rm -rf -- "$folder"/.extract_"$name".*
  mkdir -- "$temporary"
  if ! tar -xzf "$archive" -C "$temporary" --no-same-owner; then
    rm -rf -- "$temporary"
    fail "could not extract $archive (disk full?); the same command continues"
  fi
  mv -- "$temporary/rgbd_dataset_$name" "$target"
  rm -rf -- "$temporary"
  rm -f -- "$archive"
}

# N evenly spaced frames, as a recording of its own.
cut_subset() {
  local source="$folder/rgbd_dataset_$1" target="$folder/$1_$subset"
  if complete "$target"; then
    say "${1}_$subset is there: $target"
    return
  fi
  local python="${PYTHON:-python3}"
  "$python" -m miniloop_cli.datasets.subset "$source" "$target" "$subset" ||
    fail "could not make $target; is miniloop installed for $python (or set PYTHON)?"
  say "$subset frames: $target"
}

for name in "${names[@]}"; do
  fetch "$name"
  ((subset == 0)) || cut_subset "$name"
done
