#!/bin/sh
# usage, as root: as server|reconciler|worker|owner|publish-split COMMAND...   runs an operator's command as that service runs
set -eu
service="$$1" user=
if [ "$$service" = publish-split ]; then
  service=worker user=0 # reads splits, and what it puts among the uploads belongs to the server
fi
env="${folder}/etc/$$service.env"
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
PATH="${programs}:$$PATH" exec setpriv --reuid="$${user:-$$(stat -c %u "$$env")}" --regid=10001 --clear-groups --no-new-privs "$$@"
