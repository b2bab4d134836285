// Takes the events out of a text/event-stream body as its bytes arrive. Pure.
// Of the format only what our relay writes: `event`, `data` and comments, each line ended by one "\n".

export class EventReader {
  constructor() {
    this.decoder = new TextDecoder();
    this.rest = "";
  }

  // Gives the events {name, data} that these bytes complete; a comment completes none.
  push(bytes) {
    const blocks = (this.rest + this.decoder.decode(bytes, { stream: true })).split("\n\n");
    this.rest = blocks.pop();
    return blocks.map(parse).filter(({ data }) => data);
  }
}

function parse(block) {
  const lines = block.split("\n");
  const values = (field) =>
    lines.filter((line) => line.startsWith(`${field}: `)).map((line) => line.slice(field.length + 2));
  return { name: values("event")[0], data: values("data").join("\n") };
}
