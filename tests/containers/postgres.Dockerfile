# Debian's PostgreSQL 15 with what compose.cluster.yaml uses of the official image's contract, for machines
# that reach no registry: POSTGRES_USER, POSTGRES_DB, POSTGRES_PASSWORD_FILE, /var/lib/postgresql/data.
ARG BASE=docker.io/library/debian:bookworm-slim
FROM ${BASE}
RUN apt-get -q update && \
    mkdir -p /etc/postgresql-common && echo 'create_main_cluster = false' >/etc/postgresql-common/createcluster.conf && \
    DEBIAN_FRONTEND=noninteractive apt-get -q -y install --no-install-recommends postgresql-15 && \
    rm -rf /var/lib/apt/lists/* && install -d -o postgres -g postgres -m 0700 /var/lib/postgresql/data
COPY postgres-entrypoint.sh /entrypoint.sh
VOLUME ["/var/lib/postgresql/data"]
ENTRYPOINT ["/bin/sh", "/entrypoint.sh"]
