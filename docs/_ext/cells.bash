# Read by the bash of every cell: errors and progress stand where they were said, and a command that fails ends the build.
exec 2>&1
set -e
