# Renders, or does any other job of hulldown: docker run -v "$PWD:/work" hulldown render project/plan.jsonl -o project/dataset
# Debian 13 has Python 3.13 and gets Blender 5.2; with --build-arg DEBIAN=12 it's Python 3.11 and Blender 5.0.
ARG DEBIAN=13
FROM debian:${DEBIAN}
RUN apt-get update && apt-get install -y --no-install-recommends python3 python3-venv
COPY . /source
WORKDIR /source
RUN python3 -P reading/libraries.py && python3 -m venv /opt/hulldown && \
    /opt/hulldown/bin/pip install --constraint constraints.txt '.[blender,cluster]'
WORKDIR /work
ENTRYPOINT ["/opt/hulldown/bin/hulldown"]
