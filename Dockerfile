# The service in a container without shell, libraries or package manager: one static binary, one data volume, and the licence
# texts of what the binary contains in /licences.
#   docker build -t coaxis .
#   docker run --rm --read-only -p 127.0.0.1:8080:8080 -v coaxis-data:/data coaxis

FROM rust:1.95.0-slim-bookworm AS build
WORKDIR /build
COPY Cargo.toml Cargo.lock ./
COPY openapi openapi
COPY benches benches
COPY src src
COPY LICENSE docker/licences.sh docker/
# Static against glibc: nothing is looked up at run time, and its allocator is the faster one. A target must be named,
# or the flag would reach the build scripts too. Packed relocations and the missing symbols make the binary 160 MB smaller;
# a panic still names its file and line.
RUN --mount=type=cache,target=/usr/local/cargo/registry \
    --mount=type=cache,target=/build/target \
    target="$(rustc -vV | sed -n 's/^host: //p')" && \
    RUSTFLAGS="-C target-feature=+crt-static" cargo rustc --release --locked --bin coaxis --target "$target" -- \
        -C link-arg=-Wl,-z,pack-relative-relocs && \
    install -D --strip --mode=0755 "target/$target/release/coaxis" /image/coaxis && \
    install -D --mode=0644 docker/LICENSE /image/licences/coaxis.txt && \
    sh docker/licences.sh "$target" > /image/licences/third-party.txt && \
    install --directory --owner=65532 --group=65532 --mode=0750 /image/volume/data

FROM scratch
LABEL org.opencontainers.image.title="coaxis" \
      org.opencontainers.image.description="Measures the pose of a cylindrical part's axis from laser profile scans" \
      org.opencontainers.image.licenses="MIT OR Apache-2.0"
# The folder is copied with the one around it, since buildah gives the target of a copy the mode 0755.
COPY --from=build --chown=65532:65532 /image/volume /
COPY --from=build /image/coaxis /coaxis
COPY --from=build /image/licences /licences
USER 65532:65532
VOLUME ["/data"]
EXPOSE 8080
# Inside the container every address is behind the container's own network; what the line can reach is decided by the
# port that is published.
ENV COAXIS_LISTEN=0.0.0.0:8080 COAXIS_INSECURE_LAN=true COAXIS_DATA=/data
# There is no /tmp; without it SQLite could not sort what exceeds its cache, such as a new index over a large table.
ENV SQLITE_TMPDIR=/data
HEALTHCHECK --interval=10s --timeout=3s --start-period=5s --retries=3 CMD ["/coaxis", "health"]
STOPSIGNAL SIGTERM
ENTRYPOINT ["/coaxis"]
CMD ["serve"]
