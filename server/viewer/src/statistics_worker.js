// Statistics off the page's thread.
import {statisticsOf} from './statistics.js';

self.onmessage = ({data: {id, samples, edge}}) => {
  try {
    self.postMessage({id, result: statisticsOf(samples, edge)});
  } catch (error) {
    self.postMessage({id, error: String(error.message ?? error)});
  }
};
