// The object by which the modules of the page, the server's calls and the tests know one another; and the page's elements.

export const one = (selector) => document.querySelector(selector);
export const all = (selector) => [...document.querySelectorAll(selector)];

export const studio = {
  painted: [], // [revision, rung, time], the latest 500
  hearing: [], // functions of what the server says
  overlays: [], // functions that draw over the picture, of a context and of what makes pixels of the frame those of the stage
  parts: [], // functions that begin the other modules' work
  sent: new Map(), // values by path, since the server was asked for its scene
  revision: -1, rung: -1, view: "color", index: 0, moment: null, right: false, values: {}, faults: {},
};
window.studio = studio; // for the calls of the server
