# docker build -t imucal .
# docker run --rm --user "$(id -u):$(id -g)" -v "$PWD:/work" imucal lab table.csv -o out
FROM python:3.13-slim AS build
WORKDIR /src
COPY pyproject.toml README.md LICENSE ./
COPY src src
# The tests of numpy, scipy and h5py are a fifth of what an installation weighs; nothing imports them.
RUN python -m venv /opt/imucal \
 && /opt/imucal/bin/pip install --no-cache-dir . \
 && /opt/imucal/bin/pip uninstall --yes pip \
 && find /opt/imucal/lib -type d -name tests -prune -exec rm -rf {} +

FROM python:3.13-slim
COPY --from=build /opt/imucal /opt/imucal
ENV PATH="/opt/imucal/bin:$PATH" OPENBLAS_NUM_THREADS=1
USER 1000
WORKDIR /work
ENTRYPOINT ["imucal"]
