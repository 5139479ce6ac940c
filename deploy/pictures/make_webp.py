"""make_webp.py VIDEO FIRST LAST HEIGHT OUT: an animated WebP of some pictures of a video, cut off below HEIGHT pixels."""

import sys

import imageio.v2 as imageio
from PIL import Image

QUALITY = 50
MILLISECONDS = 200  # per picture


def main():
  video, first, last, height, out = sys.argv[1], *map(int, sys.argv[2:5]), sys.argv[5]
  with imageio.get_reader(video) as frames:
    pictures = [Image.fromarray(frame[:height]) for number, frame in enumerate(frames) if first <= number <= last]
  pictures[0].save(out, save_all=True, append_images=pictures[1:], duration=MILLISECONDS, loop=0, quality=QUALITY, method=6)


if __name__ == "__main__":
  main()
