import assert from "node:assert/strict";
import { test } from "node:test";

import { OwnDrive } from "../../src/control/ownDrive.js";

test("the page's drive is the one that its own connection tells first, until that ends", () => {
  const ended = [];
  const own = new OwnDrive({ me: "ann", onEnded: ({ fence }) => ended.push(fence) });
  own.receive({ driver: { user: "ann", fence: 12 } }, false);
  own.linkEnded();
  own.receive({ driver: { user: "ben", fence: 13 } }, true);
  own.receive({ driver: { user: "ann", fence: 14 } }, true);
  own.receive({ driver: { user: "ann", fence: 15 } }, true); // another window of hers
  own.linkEnded();
  own.linkEnded();
  assert.deepEqual(ended, [14]);
});
