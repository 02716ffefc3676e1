"""Takes pictures of pages, in Chromium: `python docs/_tools/page_pictures.py --help`.

Needs the packages playwright and Pillow, and Chromium, which Debian calls `chromium`.
"""

import argparse
import io
import shutil
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

IMAGES = Path(__file__).parents[1] / "images"
DESKTOP, PHONE = {"width": 1120, "height": 1300}, {"width": 360, "height": 780}
WIDE = {"width": 1280, "height": 760}
GAP = 12  # px
# Where in the film the picture is taken, as a share of its length.
MOMENT = 0.6


def main() -> None:
    """Takes every picture for which a page is given."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--report", type=Path, help="report.html of several runs")
    parser.add_argument("--index", type=Path, help="index.html")
    parser.add_argument("--diagnosis", type=Path, help="diagnosis.html")
    parser.add_argument("--out", type=Path, default=IMAGES)
    parser.add_argument("--full", action="store_true", help="whole pages, in all variants")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    looks = {"desktop": (DESKTOP, "light"), "phone": (PHONE, "light"), "dark": (DESKTOP, "dark")}
    if options.full:
        looks["phone_dark"] = (PHONE, "dark")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"))
        for name in ("report", "index", "diagnosis"):
            source = getattr(options, name)
            if source is None:
                continue
            for look, (size, scheme) in looks.items():
                if name != "report" and look != "desktop" and not options.full:
                    continue
                size = WIDE if name == "index" and size is DESKTOP else size
                page = browser.new_page(viewport=size, color_scheme=scheme)
                page.goto(source.resolve().as_uri())
                settle(page)
                suffix = f"_{look}" if name == "report" or options.full else ""
                if name == "report" and look == "phone" and not options.full:
                    pictures = [screen(page, part) for part in ("summary", "numbers", "plots")]
                else:
                    pictures = [page.screenshot(full_page=options.full)]
                save(pictures, options.out / f"{name}{suffix}.webp")
                page.close()
        browser.close()


def settle(page: Page) -> None:
    """Waits for plots, and winds the film to a moment at which something is to be seen."""
    if page.locator("#plot-data").count():
        page.wait_for_selector("html[data-ready=yes]", state="attached", timeout=60_000)
    if page.locator("video").count():
        page.evaluate(
            """share => new Promise(resolve => {
                const film = document.querySelector("video");
                const wind = () => {
                    film.addEventListener("seeked", resolve, { once: true });
                    film.controls = false;  // they lie over the picture
                    film.currentTime = share * film.duration;
                };
                film.readyState ? wind() : film.addEventListener("loadedmetadata", wind);
            })""",
            MOMENT,
        )


def screen(page: Page, part: str) -> bytes:
    """What a phone shows after a touch on one of the links at the top."""
    page.evaluate("part => document.getElementById(part).scrollIntoView()", part)
    page.wait_for_timeout(500)  # a film that comes into sight is drawn some frames later
    return page.screenshot()


def save(pictures: list[bytes], path: Path) -> None:
    """Writes pictures beside each other as one."""
    images = [Image.open(io.BytesIO(picture)).convert("RGB") for picture in pictures]
    width = sum(image.width for image in images) + GAP * (len(images) - 1)
    whole = Image.new("RGB", (width, images[0].height), (128, 128, 128))
    left = 0
    for image in images:
        whole.paste(image, (left, 0))
        left += image.width + GAP
    whole.save(path, quality=88, method=6)
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
