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
  server: {proxy: {'/v1': 'http://127.0.0.1:8080', '/openapi.json': 'http://127.0.0.1:8080'}},
});
