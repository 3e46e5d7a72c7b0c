#!/bin/sh
# usage, as root: as server|reconciler|worker|owner COMMAND...   runs an operator's command as that service runs
set -eu
env="${folder}/etc/$$1.env"
set -a
. "$$env"
set +a
shift
cd /
umask 027
PATH="${programs}:$$PATH" exec setpriv --reuid="$$(stat -c %u "$$env")" --regid=10001 --clear-groups --no-new-privs "$$@"
