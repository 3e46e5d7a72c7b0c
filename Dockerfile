# Three images from one file: `--target server` carries no shapely and no worker; `--target worker` no FastAPI;
# `--target client` is what participants and their continuous integration run. All install wheels, and no wheel holds a split.
# The base is pinned to its bytes; a newer one: docs/operating.md
ARG PYTHON=python:3.11-slim@sha256:9c900dea9e8fb7e16277c179b555cc72d29a352dbc33cff48ad5a0412fd5bfc7
FROM ${PYTHON} AS wheels
WORKDIR /build
COPY requirements/dev.txt requirements/bootstrap.txt requirements/
RUN python -m pip install --no-cache-dir --require-hashes -r requirements/bootstrap.txt
COPY pyproject.toml ./
COPY schemas schemas
COPY worker worker
COPY server server
COPY client client
COPY deploy deploy
RUN for project in . server worker; do uv build --wheel --out-dir /wheels --build-constraints requirements/dev.txt "$project"; done

FROM ${PYTHON} AS client
COPY requirements/client.txt /tmp/requirements.txt
COPY --from=wheels /wheels/exceptiondrive-*.whl /wheels/
RUN python -m pip install --no-cache-dir --require-hashes -r /tmp/requirements.txt \
 && python -m pip install --no-cache-dir --no-deps /wheels/exceptiondrive-*.whl && rm -r /wheels \
 && useradd --system --uid 10003 --create-home exceptiondrive
USER exceptiondrive
WORKDIR /work
ENTRYPOINT ["exceptiondrive"]
CMD ["--help"]

FROM ${PYTHON} AS base
RUN groupadd --gid 10001 exceptiondrive \
 && useradd --system --uid 10001 --gid 10001 --no-create-home edserver && useradd --system --uid 10002 --gid 10001 --no-create-home edworker
# A new volume takes owner and mode from the folder that it covers.
RUN install -d -o 10001 -g 10001 -m 2770 /srv/uploads && install -d -o 10002 -g 10001 -m 0700 /srv/private /srv/splits
ENV PYTHONUNBUFFERED=1 PYTHONDONTWRITEBYTECODE=1
COPY --from=wheels /wheels /wheels

FROM base AS server
COPY requirements/server.txt /tmp/requirements.txt
RUN python -m pip install --no-cache-dir --require-hashes -r /tmp/requirements.txt \
 && python -m pip install --no-cache-dir --no-deps /wheels/exceptiondrive-*.whl /wheels/exceptiondrive_server-*.whl \
 && rm /wheels/exceptiondrive_*.whl
# What is left there, the client's wheel, is what participants download from the server.
ENV EXCEPTIONDRIVE_CLIENT_DIR=/wheels
USER edserver
CMD ["exceptiondrive-server", "serve", "--host", "0.0.0.0", "--port", "8000"]

FROM base AS worker
COPY requirements/worker.txt /tmp/requirements.txt
RUN python -m pip install --no-cache-dir --require-hashes -r /tmp/requirements.txt \
 && python -m pip install --no-cache-dir --no-deps /wheels/*.whl && rm -r /wheels
USER edworker
CMD ["exceptiondrive-worker", "run", "--lanes", "live"]
