# Two images from one file: `--target server` carries no numpy and no scoring dependencies; `--target worker` no FastAPI.
# Both install the wheel, and the wheel holds no split.
FROM python:3.11-slim AS wheel
WORKDIR /build
COPY requirements/dev.txt requirements/bootstrap.txt requirements/
RUN python -m pip install --no-cache-dir --require-hashes -r requirements/bootstrap.txt
COPY pyproject.toml README.md ./
COPY schemas schemas
COPY worker worker
COPY server server
COPY client client
RUN uv build --wheel --out-dir /wheels --build-constraints requirements/dev.txt

FROM python:3.11-slim AS base
RUN groupadd --gid 10001 exceptiondrive \
 && useradd --system --uid 10001 --gid 10001 --no-create-home edserver && useradd --system --uid 10002 --gid 10001 --no-create-home edworker
# A new volume takes owner and mode from the folder that it covers.
RUN install -d -o 10001 -g 10001 -m 2770 /srv/uploads && install -d -o 10002 -g 10001 -m 0700 /srv/private
ENV PYTHONUNBUFFERED=1 PYTHONDONTWRITEBYTECODE=1
COPY --from=wheel /wheels /wheels

FROM base AS server
COPY requirements/server.txt /tmp/requirements.txt
RUN python -m pip install --no-cache-dir --require-hashes -r /tmp/requirements.txt \
 && python -m pip install --no-cache-dir --no-deps /wheels/*.whl && rm -r /wheels
USER edserver
CMD ["exceptiondrive-server", "serve", "--host", "0.0.0.0", "--port", "8000"]

FROM base AS worker
COPY requirements/worker.txt /tmp/requirements.txt
RUN python -m pip install --no-cache-dir --require-hashes -r /tmp/requirements.txt \
 && python -m pip install --no-cache-dir --no-deps /wheels/*.whl && rm -r /wheels
USER edworker
CMD ["exceptiondrive-worker", "run", "--lanes", "live"]
