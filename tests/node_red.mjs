// Runs the Node-RED flow of examples/node-red in plain Node.js against a running service: its function nodes as they are,
// and the few other node types that the flow uses, as Node-RED documents them. Another node type fails.
//
//   node tests/node_red.mjs FLOW COAXIS_URL SCAN_FILE      prints a line per check, exit code 1 at the first that fails

import assert from "node:assert";
import fs from "node:fs";
import http from "node:http";

const [, , flowFile, coaxisUrl, scanFile] = process.argv;
const nodes = JSON.parse(fs.readFileSync(flowFile, "utf8"));
const byId = new Map(nodes.map((node) => [node.id, node]));
const named = (name) => nodes.find((node) => node.name === name) ?? assert.fail(`the flow has no node ${name}`);
const tab = nodes.find((node) => node.type === "tab");

let environment;
let memory;
let reached;

function start(changes) {
    environment = new Map(tab.env.map(({ name, value }) => [name, value]));
    for (const [name, value] of Object.entries(changes)) {
        assert(environment.has(name), `the tab has no environment variable ${name}`);
        environment.set(name, value);
    }
    memory = new Map();
    reached = [];
}

function callFunction(node, msg) {
    const self = { status: () => {}, error: (text) => assert.fail(text) };
    const flow = { get: (key) => memory.get(key), set: (key, value) => memory.set(key, value) };
    const RED = { util: { generateId: () => Math.random().toString(16).slice(2).padEnd(16, "0") } };
    const body = new Function("msg", "node", "flow", "env", "RED", node.func);
    const result = body(msg, self, flow, { get: (name) => environment.get(name) }, RED);
    return Array.isArray(result) ? result : [result];
}

// `http request` with method and url from the message, and "only send errors to Catch node" off.
function request(msg) {
    return new Promise((resolve) => {
        const failed = (error) => resolve({ ...msg, payload: String(error), statusCode: error.code });
        const { method, headers, requestTimeout: timeout } = msg;
        const sent = http.request(msg.url, { method, headers, timeout }, (answer) => {
            const pieces = [];
            answer.on("data", (piece) => pieces.push(piece));
            answer.on("end", () => {
                const text = Buffer.concat(pieces).toString();
                let payload = text;
                try {
                    payload = JSON.parse(text);
                } catch {
                    // Node-RED leaves the text.
                }
                resolve({ ...msg, payload, statusCode: answer.statusCode, headers: answer.headers });
            });
        });
        sent.on("error", failed);
        sent.on("timeout", () => sent.destroy(Object.assign(new Error("no answer in time"), { code: "ETIMEDOUT" })));
        if (msg.method !== "GET") {
            sent.write(msg.payload);
        }
        sent.end();
    });
}

// Sends a message through a node and everything behind it.
async function run(node, msg) {
    reached.push({ name: node.name, msg });
    let outputs;
    switch (node.type) {
        case "inject":
        case "http in":
            outputs = [msg];
            break;
        case "function":
            outputs = callFunction(node, msg);
            break;
        case "file in":
            assert.equal(node.filenameType, "env");
            outputs = [{ ...msg, payload: fs.readFileSync(environment.get(node.filename)) }];
            break;
        case "http request":
            assert(node.method === "use" && node.ret === "obj" && node.senderr === false);
            outputs = [await request(msg)];
            break;
        case "delay":
            assert.equal(node.pauseType, "delayv");
            await new Promise((resolve) => setTimeout(resolve, Math.min(msg.delay, 20)));
            outputs = [msg];
            break;
        case "switch":
            assert.deepEqual(node.rules, [{ t: "nnull" }]);
            outputs = msg[node.property] == null ? [] : [msg];
            break;
        case "template":
            outputs = [{ ...msg, payload: node.template }];
            break;
        case "debug":
        case "http response":
            return;
        default:
            assert.fail(`this test does not know the node type ${node.type}`);
    }
    for (const [index, output] of outputs.entries()) {
        for (const id of output ? node.wires[index] : []) {
            await run(byId.get(id) ?? assert.fail(`${node.name} leads to a node that does not exist`), output);
        }
    }
}

const last = (name) => reached.findLast((step) => step.name === name)?.msg;
const count = (name) => reached.filter((step) => step.name === name).length;

const checks = {
    "a scan is measured": async () => {
        start({ COAXIS_URL: coaxisUrl, SCAN_FILE: scanFile });
        await run(named("Measure the file"), {});
        const { payload } = last("accepted");
        assert(payload.verdict === "accepted" && Number.isFinite(payload.deflection_deg) && payload.u_deflection_deg > 0);
        const first = payload.id;
        reached = [];
        await run(named("Read the scan"), { requestId: payload.request_id });
        assert.equal(last("accepted").payload.id, first, "the same request id has to give the first answer");
    },
    "a file that is no scan is a problem": async () => {
        start({ COAXIS_URL: coaxisUrl, SCAN_FILE: flowFile });
        await run(named("Measure the file"), {});
        assert(last("problem").payload.status >= 400 && last("problem").payload.code !== "no_answer");
        assert.equal(count("POST /v1/measurements"), 1, "a problem of the request must not be repeated");
    },
    "the state of the cell is read": async () => {
        start({ COAXIS_URL: coaxisUrl });
        await run(named("Every second"), {});
        assert.equal(last("cell").payload.state, "idle");
        await run(named("GET /coaxis/state"), { res: {} });
        assert.equal(last("State").payload.cell.state, "idle");
    },
    "the page has a stop button": async () => {
        await run(named("GET /coaxis"), { res: {} });
        assert.match(last("Page").payload, /<button id="stop">/);
    },
    "the stop reaches the cell": async () => {
        start({ COAXIS_URL: coaxisUrl });
        await run(named("STOP"), {});
        assert.equal(typeof last("stop").payload.confirmed, "boolean");
        assert.equal(count("Stop report"), 0);
        await run(named("POST /coaxis/stop"), { res: {} });
        assert.equal(last("Stop report").statusCode, 200);
    },
    "a service that does not answer is reported": async () => {
        start({ COAXIS_URL: "http://127.0.0.1:9", SCAN_FILE: scanFile });
        await run(named("Every second"), {});
        assert.equal(memory.get("cell").state, "unknown");
        await run(named("Measure the file"), {});
        assert.equal(last("problem").payload.code, "no_answer");
        assert.equal(count("POST /v1/measurements"), 4);
        await run(named("POST /coaxis/stop"), { res: {} });
        assert.equal(last("Stop report").statusCode, 502);
        assert.equal(last("Stop report").payload.confirmed, false);
    },
};

for (const [name, check] of Object.entries(checks)) {
    try {
        await check();
    } catch (error) {
        console.log(`${name}: ${error.message}`);
        process.exit(1);
    }
    console.log(`${name}: ok`);
}
