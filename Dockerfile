# Renders, or does any other job of hulldown: docker run -v "$PWD:/work" hulldown render project/plan.jsonl -o project/dataset
FROM debian:12
RUN apt-get update && apt-get install -y --no-install-recommends python3 python3-venv
COPY . /source
WORKDIR /source
RUN python3 -P reading/libraries.py && python3 -m venv /opt/hulldown && \
    /opt/hulldown/bin/pip install --constraint constraints.txt '.[blender,cluster]'
WORKDIR /work
ENTRYPOINT ["/opt/hulldown/bin/hulldown"]
