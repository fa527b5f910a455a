// Makes the README's picture. usage: STRATA=path/to/strata node test/screenshot.mjs OUT.png
import {openViewer, settled, SPOT, startBrowser, startServer} from './support.mjs';

const server = await startServer();
const {browser} = await startBrowser();
try {
  const {page} = await openViewer(browser, server.origin, {viewport: {width: 1200, height: 800}});
  await page.setInputFiles('#file', SPOT);
  await settled(page);
  await page.check('[value=strokes]');
  await page.check('#compare');
  await page.waitForSelector('#distances .series-1');
  for (let i = 0; i < 12; ++i) await page.press('#canvas', 'ArrowLeft');
  for (let i = 0; i < 2; ++i) await page.press('#canvas', '+');
  await page.evaluate(() => document.activeElement.blur());
  await page.screenshot({path: process.argv[2]});
} finally {
  await browser.close();
  await server.stop();
}
