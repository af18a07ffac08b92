# miniloop in a container:
#
#   docker build -t miniloop .
#   docker run --rm miniloop demo --help
#   docker run --rm --user "$(id -u):$(id -g)" -v "$PWD:/work" -v miniloop-cache:/cache miniloop register recording
#
# Without meshes, a gigabyte smaller:   docker build --build-arg MESH=no -t miniloop .

FROM debian:trixie-slim AS build
ARG MESH=yes
# hadolint ignore=DL3008
RUN apt-get update && apt-get install -y --no-install-recommends python3-venv
RUN python3 -m venv /opt/miniloop
COPY . /source
RUN /opt/miniloop/bin/pip install --no-cache-dir /source \
    && if [ "$MESH" != yes ]; then /opt/miniloop/bin/pip uninstall -y open3d; fi

FROM debian:trixie-slim
ARG MESH=yes
# Beside Python, what open3d loads; nothing else in miniloop needs these.
# hadolint ignore=DL3008,SC2086
RUN if [ "$MESH" = yes ]; then mesh="libegl1 libgl1 libgomp1 libidn2-0 libusb-1.0-0"; fi \
    && apt-get update && apt-get install -y --no-install-recommends python3 $mesh && rm -rf /var/lib/apt/lists/*
COPY --from=build /opt/miniloop /opt/miniloop

# An ordinary user; any other (--user) may write to the cache, too. Kernels are compiled once and kept there.
RUN useradd --create-home --uid 1000 miniloop && mkdir -p /cache /work && chmod 1777 /cache /work
ENV PATH=/opt/miniloop/bin:$PATH \
    XDG_CACHE_HOME=/cache \
    MPLCONFIGDIR=/cache/matplotlib \
    PYTHONUNBUFFERED=1
USER 1000
VOLUME /cache
WORKDIR /work
ENTRYPOINT ["miniloop"]
CMD ["--help"]
