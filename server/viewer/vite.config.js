import {defineConfig} from 'vite';

// No hashes in the names: the server revalidates with ETags, and a rebuilt dist/ stays readable in
// git.
const names = {
  entryFileNames: 'assets/[name].js',
  chunkFileNames: 'assets/[name].js',
  assetFileNames: 'assets/[name][extname]',
};

export default defineConfig({
  build: {
    target: 'es2022',
    assetsInlineLimit:
        0,  // Its content security policy lets the page load files, not data: addresses.
    modulePreload: {polyfill: false},
    chunkSizeWarningLimit: 1024,  // KB: three.js is what it is.
    rolldownOptions: {output: names},
  },
  worker: {format: 'es', rolldownOptions: {output: names}},
  server: {
    // As an object: Host stays the page's own, which the service compares with Origin.
    proxy: {
      '/v1': {target: 'http://127.0.0.1:8080'},
      '/openapi.json': {target: 'http://127.0.0.1:8080'},
    },
  },
});
