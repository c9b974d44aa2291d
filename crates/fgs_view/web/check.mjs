// Looks at a page in a headless Chromium: no errors, something is drawn, and a map in the colours of the renders
// beside it. check.sh does so with every kind of page.
//   npm install puppeteer-core
//   node check.mjs URL PICTURE.png [seconds to wait] [CSS selector to click first]
// Works without a graphics card (SwiftShader). CHROMIUM names the browser.

import puppeteer from "puppeteer-core";

const [url, picture, secs = "20", click] = process.argv.slice(2);
const sleep = (secs) => new Promise((resolve) => setTimeout(resolve, 1000 * secs));
const browser = await puppeteer.launch({
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
  args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
  protocolTimeout: 180000,
});
const page = await browser.newPage();
await page.setViewport({ width: 1600, height: 1000 });
const errors = [];
page.on("console", (message) => { if (["error", "warn"].includes(message.type())) errors.push(message.text()); });
page.on("pageerror", (error) => errors.push(error.message));
page.on("requestfailed", (request) => errors.push(`${request.url()}: ${request.failure()?.errorText}`));
page.on("response", (response) => { if (response.status() >= 400) errors.push(`${response.status()} ${response.url()}`); });
await page.goto(url, { waitUntil: "domcontentloaded" });
await sleep(secs);
if (click) { await page.click(click); await sleep(10); }
await page.screenshot({ path: picture });
const found = errors.splice(0);

// The drawn map, by the browser's own decoder, against the pictures beside it. A report has none.
const view = await page.$("#view");
const canvas = await (view ?? page).screenshot({ encoding: "base64" });
const result = await page.evaluate(async (png) => {
  const pixels = async (source) => {
    const image = new Image();
    image.src = source;
    await image.decode();
    const sheet = new OffscreenCanvas(image.width, image.height).getContext("2d");
    sheet.drawImage(image, 0, 0);
    return sheet.getImageData(0, 0, image.width, image.height).data;
  };
  const drawn = await pixels(`data:image/png;base64,${png}`);
  const count = drawn.length / 4, gray = Array.from({ length: count }, (_, i) => drawn[4 * i + 1]);
  const mean = gray.reduce((a, b) => a + b) / count;
  const deviation = Math.sqrt(gray.reduce((sum, x) => sum + (x - mean) ** 2, 0) / count);
  // Shares of 64 colours.
  const shares = (data) => {
    const shares = new Array(64).fill(0);
    for (let i = 0; i < data.length; i += 4) shares[((data[i] >> 6) << 4) | ((data[i + 1] >> 6) << 2) | (data[i + 2] >> 6)] += 4 / data.length;
    return shares;
  };
  const renders = [...document.querySelectorAll("#picture-1, .card figure:last-child img")].filter((image) => image.complete && image.src);
  const inMap = shares(drawn);
  const common = (await Promise.all(renders.slice(0, 5).map((image) => pixels(image.src)))).map(shares)
    .flatMap((shares) => shares.map((share, i) => (share > 0.1 ? inMap[i] : 1)));
  return { deviation, rarest: Math.min(...common), renders: renders.length };
}, canvas);
await browser.close();
console.log(url, JSON.stringify({ errors: found, ...result }));
const showsMap = !view || (result.renders > 0 && result.rarest > 0.002);
// A report is mostly paper.
const isGood = found.length === 0 && result.deviation > (view ? 20 : 10) && showsMap;
process.exit(isGood ? 0 : 1);
