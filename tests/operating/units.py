"""Plays systemd for the units of a server without containers: `python -m tests.operating.units VERB UNIT...`

It takes from each unit what this machine can do without systemd: user, settings, commands, what the unit may
bind; not its walls, which tests/deploy/test_bare.py has systemd's own reader check. WALK_UNITS names the
folder of the units, WALK_STATE where process ids and logs are kept.
"""

import os
import shlex
import signal
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path

GROUP = "10001"
Unit = dict[str, list[str]]


def read_unit(path: Path) -> Unit:
    """Return the settings of a unit; one may stand several times."""
    found: Unit = defaultdict(list)
    for line in path.read_text().replace("\\\n", " ").splitlines():
        if "=" in line and not line.startswith("#"):
            key, _, value = line.partition("=")
            found[key].append(value)
    return found


class Systemd:
    """Starts and stops units, as `systemctl` asks for it."""

    def __init__(self, units: Path, state: Path) -> None:
        self._units = units
        self._state = state

    def start(self, name: str) -> None:
        if name.endswith(".target"):
            for wanted in " ".join(self._read(name)["Wants"]).split():
                self.start(wanted)
        elif not name.endswith(".timer") and not self._lives(name):
            self._spawn(name, self._read(name))

    def stop(self, name: str) -> None:
        if name.endswith(".target"):
            for path in sorted(self._state.glob("*.pid")):
                self.stop(path.stem)
            return
        deadline = time.monotonic() + 60
        if self._lives(name):
            os.kill(self._pid(name), signal.SIGTERM)
        while self._lives(name):
            if time.monotonic() > deadline:
                sys.exit(f"{name} does not stop")
            time.sleep(0.05)
        (self._state / f"{name}.pid").unlink(missing_ok=True)

    def reload(self, name: str) -> None:
        os.kill(self._pid(name), signal.SIGHUP)

    def _pid(self, name: str) -> int:
        return int((self._state / f"{name}.pid").read_text())

    def _read(self, name: str) -> Unit:
        stem, at, instance = name.partition("@")
        file = self._units / f"{stem}{at}{'.service' if at else ''}"
        found = read_unit(file)
        of_instance = instance.removesuffix(".service")
        return defaultdict(
            list, {k: [v.replace("%i", of_instance) for v in vs] for k, vs in found.items()}
        )

    def make_accounts(self) -> None:
        """What `systemd-sysusers` reads of a file, in the folder of the state."""
        lines = (self._state / "exceptiondrive.conf").read_text().splitlines()
        ids = [line.split()[2].partition(":")[0] for line in lines if line.startswith("u ")]
        (self._state / "accounts").write_text(" ".join(ids))

    def _spawn(self, name: str, unit: Unit) -> None:
        (user,) = unit["User"]
        if user not in (self._state / "accounts").read_text().split():
            sys.exit(f"{name}: status=217/USER, nobody has the number {user}")
        own = self._state / f"tmp-{user}"  # systemd would give it a /tmp of its own
        own.mkdir(exist_ok=True)
        os.chown(own, int(user), int(GROUP))
        environment = {"PATH": os.environ["PATH"], "TMPDIR": str(own)}
        for file in unit["EnvironmentFile"]:
            for line in Path(file).read_text().splitlines():
                key, _, value = line.partition("=")
                environment[key] = value
        caps = ["--inh-caps=+net_bind_service", "--ambient-caps=+net_bind_service"]
        identity = ["setpriv", f"--reuid={user}", f"--regid={GROUP}", "--clear-groups"]
        identity += ["--no-new-privs", *(caps if unit["AmbientCapabilities"] else [])]
        log = (self._state / f"{name}.log").open("ab")
        for command in unit["ExecStart"]:
            words = shlex.split(command.replace("%%", "%").replace("$$", "$"))
            if "nginx.conf" in command:
                words = [self._with_own_tmp(word, own) for word in words]
            process = subprocess.Popen(
                [*identity, *words],
                env=environment,
                cwd="/",
                umask=0o027,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
            if unit["Type"] == ["oneshot"]:
                if process.wait() != 0:
                    sys.exit(f"{name} failed:\n{(self._state / f'{name}.log').read_text()}")
            else:
                (self._state / f"{name}.pid").write_text(str(process.pid))

    def _with_own_tmp(self, word: str, own: Path) -> str:
        if not word.endswith("nginx.conf"):
            return word
        copy = self._state / "nginx.conf"
        text = Path(word).read_text().replace("_path /tmp/", f"_path {own}/")
        copy.write_text(text.replace("/run/exceptiondrive-proxy/", f"{own}/"))
        return str(copy)

    def _lives(self, name: str) -> bool:
        try:
            status = Path(f"/proc/{self._pid(name)}/stat")
            return status.read_text().rpartition(")")[2].split()[0] != "Z"
        except (FileNotFoundError, ProcessLookupError):
            return False


def main(verb: str, *words: str) -> None:
    """Do what `systemctl VERB WORDS` would do."""
    systemd = Systemd(Path(os.environ["WALK_UNITS"]), Path(os.environ["WALK_STATE"]))
    if verb == "make-accounts":
        systemd.make_accounts()
    names = [word if "." in word else f"{word}.service" for word in words if word[0] != "-"]
    does = {"enable": ["start"], "restart": ["stop", "start"], "daemon-reload": []}
    for step in does.get(verb, [verb]):
        for name in names:
            getattr(systemd, step)(name)


if __name__ == "__main__":
    main(*sys.argv[1:])
