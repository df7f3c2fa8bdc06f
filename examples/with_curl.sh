#!/bin/sh
# From a shell: with_curl.sh scan.ply mesh.glb. UDFLOW_URL and UDFLOW_KEY as for the other examples,
# CONFIG may hold parameters as JSON.
set -eu
url=${UDFLOW_URL:-http://127.0.0.1:8000}
ask() { curl --silent --show-error --fail-with-body -H "Authorization: Bearer ${UDFLOW_KEY:-}" "$@"; }

# upload and job in one go; the id is the first string that looks like one
job=$(ask -F "file=@$1" -F "config=${CONFIG:-{\}}" "$url/v1/jobs" | grep -o 'job_[0-9a-z]*' | head -1)
echo "$job"

# long poll: answers when the job has ended, or after a minute
until ask "$url/v1/jobs/$job?wait=60" | grep -q '"finished_at":"'; do :; done

ask -o "$2" "$url/v1/jobs/$job/mesh?format=${2##*.}"
ask -H 'Content-Type: application/json' -d '{"points": [[0, 0, 0]]}' "$url/v1/jobs/$job/udf"
