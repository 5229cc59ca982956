// What comes over the socket; made from clsco/studio/pictures.py by python -m tests.studio.protocol.

export const RUNG = { DRAGGING: 0, LOSSY: 1, EXACT: 2, PINNED: 3, STACKED: 4, OUTLINED: 5 };
export const ENCODING = { MESSAGE: 0, JPEG: 1, PNG: 2, FLOAT32: 3 };
export const VIEWS = ["color", "sharp", "depth", "blur radius", "flow", "normal", "id", "mask", "missing", "raw", "noise"];
export const NO_NUMBER = 4294967295; // of a picture of a moment, in place of a frame's

const HEAD = 20; // bytes before the payload

const header = (buffer) => {
  const head = new DataView(buffer, 0, HEAD);
  return {
    revision: head.getUint32(0, true),
    rung: head.getUint8(4),
    view: head.getUint8(5),
    width: head.getUint16(6, true),
    height: head.getUint16(8, true),
    encoding: head.getUint8(10),
    columns: head.getUint16(11, true),
    rows: head.getUint16(13, true),
    flags: head.getUint8(15),
    number: head.getUint32(16, true),
  };
};

/** @param {ArrayBuffer} buffer */
export const opened = (buffer) => {
  const { view, columns, rows, flags, ...rest } = header(buffer);
  const picture = {
    ...rest, view: VIEWS[view], full: [columns, rows], right: Boolean(flags & 2), still: Boolean(flags & 1),
  };
  return { picture, payload: new Uint8Array(buffer, HEAD) };
};
