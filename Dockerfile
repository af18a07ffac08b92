# miniloop in a container:
#
#   docker build -t miniloop .
#   docker run --rm miniloop demo --help
#   docker run --rm --user "$(id -u):$(id -g)" -v "$PWD:/work" -v miniloop-cache:/cache miniloop register recording
#
# Without meshes, a gigabyte smaller:   docker build --build-arg MESH=no -t miniloop .

FROM python:3.12-slim AS build
COPY . /source
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels /source

FROM python:3.12-slim
ARG MESH=yes
# What open3d loads; nothing else in miniloop needs these.
RUN if [ "$MESH" = yes ]; then \
      apt-get update \
      && apt-get install -y --no-install-recommends libegl1 libgl1 libgomp1 libusb-1.0-0 \
      && rm -rf /var/lib/apt/lists/*; \
    fi
COPY --from=build /wheels /wheels
RUN pip install --no-cache-dir /wheels/*.whl \
    && if [ "$MESH" != yes ]; then pip uninstall -y open3d; fi \
    && rm -rf /wheels

# An ordinary user; any other (--user) may write to the cache, too. Kernels are compiled once and kept there.
RUN useradd --create-home miniloop && mkdir -p /cache /work && chmod 1777 /cache /work
ENV MINILOOP_CACHE=/cache/miniloop \
    NUMBA_CACHE_DIR=/cache/numba \
    MPLCONFIGDIR=/cache/matplotlib \
    PYTHONUNBUFFERED=1
USER miniloop
VOLUME /cache
WORKDIR /work
ENTRYPOINT ["miniloop"]
CMD ["--help"]
