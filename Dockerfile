# A node of a Ray cluster that has dcgrid, on the CPU (docs/clusters.md).
FROM python:3.12-slim
WORKDIR /opt/dcgrid
COPY pyproject.toml README.md LICENSE ./
COPY dcgrid_env dcgrid_env
COPY baselines baselines
COPY agents agents
COPY traces traces
COPY apps apps
RUN pip install --no-cache-dir torch --index-url https://download.pytorch.org/whl/cpu \
    && pip install --no-cache-dir ".[agents,ray]" "ray[default]"
WORKDIR /work
