#!/bin/sh
# usage, as root: as server|reconciler|worker|owner COMMAND...   runs an operator's command as that service runs
set -eu
env="${folder}/etc/$$1.env"
shift
# Its lines as systemd takes them: a value may hold blanks and signs, and quotes around it are none of it.
while IFS= read -r line || [ -n "$$line" ]; do
  value="$${line#*=}"
  case "$$value" in
    \"*\" | \'*\') value="$${value#?}" value="$${value%?}" ;;
  esac
  case "$$line" in
    [A-Za-z_]*=*) export "$${line%%=*}=$$value" ;;
  esac
done <"$$env"
cd /
umask 027
PATH="${programs}:$$PATH" exec setpriv --reuid="$$(stat -c %u "$$env")" --regid=10001 --clear-groups --no-new-privs "$$@"
