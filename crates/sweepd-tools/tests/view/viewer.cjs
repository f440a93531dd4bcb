// Foxglove's own client: subscribes to all that is offered, and prints a line of JSON for each event. Of a message, that is
// its bytes, and what Foxglove's reader makes of them by the schema that came with the channel.
//
// usage: node viewer.cjs ADDRESS PROTOCOL, with the packages in NODE_PATH
"use strict";
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");
const { WebSocket } = require("ws");

const [address, protocol] = process.argv.slice(2);
const socket = new WebSocket(address, [protocol]);
const client = new FoxgloveClient({ ws: socket });
const subscribed = new Map();

const print = (event, value) => console.log(JSON.stringify({ event, ...value }));

function summary(topic, message) {
  if (topic.endsWith("/points")) {
    const { header, height, width, point_step, data } = message;
    const fields = message.fields.map((field) => field.name).join(" ");
    return { stamp: header.stamp, frame: header.frame_id, points: height * width, fields, whole: data.length === width * point_step };
  }
  if (topic.endsWith("/markers")) {
    return { boxes: message.markers.map((marker) => marker.id) };
  }
  return message;
}

client.on("error", (error) => print("error", { text: String(error) }));
client.on("close", () => process.exit(0));
client.on("serverInfo", ({ name, capabilities }) => print("serverInfo", { name, capabilities, protocol: socket.protocol }));
client.on("status", ({ level, message }) => print("status", { level, message }));
client.on("time", ({ timestamp }) => print("time", { time: String(timestamp) }));
client.on("unadvertise", (ids) => print("unadvertise", { ids }));
client.on("advertise", (channels) => {
  for (const { id, topic, encoding, schemaName, schema, schemaEncoding } of channels) {
    print("advertise", { topic, encoding, schemaName, schemaEncoding });
    const reader = new MessageReader(parse(schema, { ros2: true }));
    subscribed.set(client.subscribe(id), { topic, reader });
  }
});
client.on("message", ({ subscriptionId, timestamp, data }) => {
  const { topic, reader } = subscribed.get(subscriptionId);
  const bytes = Buffer.from(data.buffer, data.byteOffset, data.byteLength);
  print("message", {
    topic,
    time: String(timestamp),
    bytes: bytes.toString("hex"),
    read: summary(topic, reader.readMessage(bytes)),
  });
});
