"""make_gif.py FOLDER EPISODE PICTURES OUT: an animated GIF of the first pictures of an episode (craftfleet eval --pictures)."""

import sys

from PIL import Image

COLORS = 128
MILLISECONDS = 120  # per picture


def main():
  folder, episode, count, out = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4]
  pictures = [Image.open(f"{folder}/episode-{episode:04d}-step-{step:05d}.png").convert("RGB") for step in range(count)]
  width, height = pictures[0].size
  sheet = Image.new("RGB", (width, height * count))  # all pictures share one palette
  for i, picture in enumerate(pictures):
    sheet.paste(picture, (0, i * height))
  palette = sheet.quantize(COLORS, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
  frames = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
  frames[0].save(out, save_all=True, append_images=frames[1:], duration=MILLISECONDS, loop=0, optimize=False)


if __name__ == "__main__":
  main()
