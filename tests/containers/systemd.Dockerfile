# A Debian with systemd as its first process and the package installed.
ARG BASE=docker.io/library/debian:bookworm-slim
FROM ${BASE}
COPY strata.deb /debs/
RUN apt-get -q update && DEBIAN_FRONTEND=noninteractive apt-get -q -y install --no-install-recommends \
      curl systemd /debs/strata.deb && rm -rf /var/lib/apt/lists/*
CMD ["/lib/systemd/systemd"]
