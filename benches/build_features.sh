#!/bin/sh
# What each cargo feature costs to build: seconds and bytes of the release binary, as rows of a Markdown table.
#
#   benches/build_features.sh [TARGET_DIR]
#
# Without any feature first, into an empty folder: all that the others share. Then each feature alone on top of that: its
# own dependencies, and presight again; `presight alone` is what the latter takes. Last all features together, from what
# the others left. Needs the crates to be fetched (cargo fetch), 5 GB, and a quarter of an hour on two quiet cores.
set -eu
cd "$(dirname "$0")/.."
folder=${1:-$(mktemp -d /tmp/build_features.XXXXXX)}
mkdir -p "$folder"
if [ -n "$(ls -A "$folder")" ]; then
    echo "$folder is not empty: seconds would be those of what is missing there" >&2
    exit 2
fi

# Builds with the features named (comma-separated, or nothing) and prints a row.
row() {
    start=$(date +%s.%N)
    cargo build --offline --quiet --release -p presight-cli --no-default-features --features "$2" --target-dir "$folder"
    end=$(date +%s.%N)
    bytes=$(stat -c %s "$folder/release/presight")
    strip -o "$folder/stripped" "$folder/release/presight"
    stripped=$(stat -c %s "$folder/stripped")
    echo "| $1 | $(echo "$end $start" | awk '{printf "%.0f", $1 - $2}') | $bytes | $stripped |"
}

echo "| features | seconds | bytes of the binary | bytes stripped |"
echo "|---|---|---|---|"
row "none, from nothing" ""
touch src/lib.rs crates/presight-cli/src/lib.rs crates/presight-studies/src/lib.rs
row "none, presight alone" ""
for feature in store script report gpu; do
    row "$feature, on top" "$feature"
done
row "all, on top" "store,script,report,gpu"
