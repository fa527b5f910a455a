# Debian's nginx where the front of compose.cluster.yaml expects one, for machines that reach no registry.
ARG BASE=docker.io/library/debian:bookworm-slim
FROM ${BASE}
RUN apt-get -q update && DEBIAN_FRONTEND=noninteractive apt-get -q -y install --no-install-recommends nginx-light && \
    rm -rf /var/lib/apt/lists/*
CMD ["nginx", "-g", "daemon off;"]
