// Calls to a worker as promises.

/**
 * A function that posts its argument to `worker` and resolves to what it answers. The worker
 * answers {id, result} or {id, error} to {id, ...message}.
 * @param {Worker} worker
 */
export function callerOf(worker) {
  const waiting = new Map();
  let last = 0;
  const finish = (id, settle) => {
    const call = waiting.get(id);
    waiting.delete(id);
    if (call) settle(call);
  };
  worker.onmessage = ({data}) => finish(
      data.id,
      (call) => data.error ? call.reject(new Error(data.error)) : call.resolve(data.result));
  worker.onerror = (event) => {
    for (const id of [...waiting.keys()]) {
      finish(id, (call) => call.reject(new Error(event.message || 'a worker could not start')));
    }
  };
  return (message, transfer = []) => new Promise((resolve, reject) => {
           waiting.set(++last, {resolve, reject});
           worker.postMessage({...message, id: last}, transfer);
         });
}
