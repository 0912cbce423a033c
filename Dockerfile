# edit3r on a CPU, with the app:
#   docker build -t edit3r .
#   docker run --rm -it -p 8000:8000 -v "$PWD/scenes:/scenes" edit3r
# One command instead of the app: docker run --rm -v "$PWD:/work" -w /work edit3r run a.jpg b.jpg --prompt "paint it red"
FROM python:3.12-slim
COPY . /source
# torch's CPU build: without it, 3 GB of CUDA for nothing.
RUN pip install --no-cache-dir "uv>=0.5" \
    && uv pip install --system --no-cache --torch-backend=cpu -c /source/constraints.txt "/source[app,mp4,export,heic]" \
    && rm -r /source \
    && useradd --create-home edit3r && mkdir /scenes && chown edit3r /scenes
USER edit3r
VOLUME ["/scenes", "/home/edit3r/.cache/edit3r"]
EXPOSE 8000
ENTRYPOINT ["edit3r"]
CMD ["app", "--host", "0.0.0.0", "--port", "8000", "--jobs", "/scenes"]
