# LEMMA Bench in the browser, for the processor alone: no CUDA, pictures by Mesa.
#
#   docker build -t lemma-bench --build-arg TORCH_INDEX=ADDRESS .
#   docker run --rm -p 8080:8080 lemma-bench
#
# TORCH_INDEX is the address of the index of torch's builds for processors, which its
# maintainers name where they say how to install it. Without it the usual build is
# installed, which on most machines brings CUDA along: it works, and takes gigabytes.
FROM python:3.11-slim

# Off-screen OpenGL.
RUN apt-get update \
    && apt-get install -y --no-install-recommends libegl1 libgl1 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/*

WORKDIR /lemma
ENV SITE=/usr/local/lib/python3.11/site-packages LEMMA_WEIGHTS=/lemma/weights

# What a page needs of torch is a third of it: no headers, no programs, no tests.
COPY constraints.txt ./
ARG TORCH_INDEX=""
RUN pip install --no-cache-dir --no-compile -c constraints.txt torch==2.13.0 \
    ${TORCH_INDEX:+--index-url "$TORCH_INDEX"} \
    && rm -rf $SITE/torch/include $SITE/torch/test \
    && find $SITE/torch/bin -type f ! -name torch_shm_manager -delete

COPY pyproject.toml README.md LICENSE ./
COPY src src
COPY weights weights
RUN pip install --no-cache-dir --no-compile -c constraints.txt ".[play]" "safetensors>=0.4" \
    && find $SITE -type d -name tests -prune -exec rm -r {} +

# Compiles what runs in every step, once instead of in every container, and byte-code of
# what is imported alone. It fails where nothing can be drawn.
RUN python -c "import lemma.viewer.page" \
    && lemma demo stack --policy reachnet --no-video

EXPOSE 8080
ENTRYPOINT ["lemma"]
# 0.0.0.0 is the container's own; -p says who else reaches it.
CMD ["play", "--host", "0.0.0.0", "--port", "8080", "--no-open"]
