import { describe, expect, test } from "vitest";
import { NoPreview, type Scan } from "../src/pure/formats/collector";
import { readScan } from "../src/pure/formats/index";
import { readPlyMesh } from "../src/pure/formats/ply";
import { glb, npy, type Part, zip } from "./files";

const TWO = [
  [1, 2, 3],
  [4, 5, 6],
];

function read(parts: Part[], most = 1000): Promise<Scan> {
  const blob = new Blob(parts);
  return readScan((from, to) => blob.slice(from, to).arrayBuffer(), blob.size, most);
}

/** Positions as the file has them. */
function points(scan: Scan): number[][] {
  return Array.from({ length: scan.positions.length / 3 }, (_, i) =>
    [0, 1, 2].map((axis) => scan.positions[3 * i + axis] + scan.origin[axis]),
  );
}

function header(format: string, count: number, properties: string[], more: string[] = []): string {
  const lines = ["ply", `format ${format} 1.0`, `element vertex ${count}`, ...properties, ...more];
  return `${[...lines, "end_header"].join("\n")}\n`;
}

const XYZ = ["x", "y", "z"].map((axis) => `property float ${axis}`);
const RGB = ["red", "green", "blue"].map((name) => `property uchar ${name}`);
const NORMALS = ["nx", "ny", "nz"].map((name) => `property float ${name}`);

function rows(little: boolean): Uint8Array<ArrayBuffer> {
  const view = new DataView(new ArrayBuffer(30));
  for (const [i, value] of [1, 2, 3, 4, 5, 6].entries()) {
    view.setFloat32(15 * Math.floor(i / 3) + 4 * (i % 3), value, little);
  }
  for (let i = 0; i < 3; i++) {
    view.setUint8(12 + i, 10 * i);
    view.setUint8(27 + i, 200 + i);
  }
  return new Uint8Array(view.buffer);
}

describe("PLY", () => {
  test.each([
    ["binary_little_endian", rows(true)],
    ["binary_big_endian", rows(false)],
    ["ascii", "1 2 3 0 10 20\n4 5 6 200 201 202"],
  ])("%s, with colours", async (format, body) => {
    const scan = await read([header(format, 2, [...XYZ, ...RGB]), body]);
    expect(points(scan)).toEqual([
      [1, 2, 3],
      [4, 5, 6],
    ]);
    expect([...(scan.colors ?? [])]).toEqual([0, 10, 20, 200, 201, 202]);
    expect(scan).toMatchObject({ format: "ply", total: 2, hasColors: true, hasNormals: false });
    expect([scan.low, scan.high]).toEqual([
      [1, 2, 3],
      [4, 5, 6],
    ]);
  });

  test("properties in another order, with normals and faces behind", async () => {
    const properties = [...NORMALS, XYZ[2], XYZ[0], XYZ[1]];
    const faces = ["element face 1", "property list uchar int vertex_indices"];
    const body = "0 0 1 30 10 20\n0 0 1 31 11 21\n3 0 1 1\n";
    const scan = await read([header("ascii", 2, properties, faces), body]);
    expect(points(scan)).toEqual([
      [10, 20, 30],
      [11, 21, 31],
    ]);
    expect(scan.hasNormals).toBe(true);
  });

  test.each([
    ["ends early", [header("binary_little_endian", 3, XYZ), new Float32Array(6)], /ends early/],
    ["promises too much", [header("binary_little_endian", 2 ** 40, XYZ)], /ends early/],
    ["a count below zero", [header("ascii", -4, XYZ), "1 2 3\n"], /broken/],
    ["no end of the header", ["ply\nformat ascii 1.0\n"], /no end/],
    ["no z", [header("ascii", 1, XYZ.slice(0, 2)), "1 2\n"], /no x, y and z/],
    ["an unknown type", [header("ascii", 1, ["property quad x"]), "1\n"], /unknown type/],
    ["a list in a vertex", [header("ascii", 1, ["property list uchar int x"]), "1\n"], /lists/],
  ] as [string, Part[], RegExp][])("refused: %s", async (_, parts, reason) => {
    await expect(read(parts)).rejects.toThrow(reason);
    await expect(read(parts)).rejects.toBeInstanceOf(NoPreview);
  });
});

describe("a mesh of the service", () => {
  const DOUBLE = ["x", "y", "z"].map((axis) => `property double ${axis}`);
  const FACES = ["element face 1", "property list uchar int vertex_indices"];

  function mesh(corners: number): ArrayBuffer {
    const text = new TextEncoder().encode(header("binary_little_endian", 3, DOUBLE, FACES));
    const buffer = new ArrayBuffer(text.length + 72 + 13);
    new Uint8Array(buffer).set(text);
    const view = new DataView(buffer, text.length);
    [5e6, 1, 2, 5e6 + 0.001, 1, 2, 5e6, 1.5, 2].forEach((value, i) => {
      view.setFloat64(8 * i, value, true);
    });
    view.setUint8(72, corners);
    [0, 2, 1].forEach((value, i) => {
      view.setInt32(73 + 4 * i, value, true);
    });
    return buffer;
  }

  test("keeps millimetres on the map", () => {
    const found = readPlyMesh(mesh(3));
    expect(found.origin).toEqual([5e6, 1, 2]);
    expect(found.positions[3]).toBeCloseTo(0.001, 8);
    expect([...found.indices]).toEqual([0, 2, 1]);
    expect(found.colors).toBeNull();
  });

  test("is refused when cut off, or not of triangles", () => {
    expect(() => readPlyMesh(mesh(3).slice(0, -1))).toThrow("not what it says");
    expect(() => readPlyMesh(mesh(4))).toThrow("no triangles");
  });
});

describe("rows of text", () => {
  test("with comments, a heading, commas and CRLF", async () => {
    const scan = await read(["# a scan\r\nx,y,z\r\n1,2,3\r\n4,5,6\r\n"]);
    expect(points(scan)).toEqual([
      [1, 2, 3],
      [4, 5, 6],
    ]);
    expect(scan.hasColors).toBe(false);
  });

  test("colours are told from other columns", async () => {
    const colored = await read(["0 0 0 255 0 128\n1 1 1 1 2 3\n2 2 2 0 0 0\n"]);
    expect([...(colored.colors ?? []).slice(0, 3)]).toEqual([255, 0, 128]);
    const normals = await read(["0 0 0 0.1 0.2 0.97\n1 1 1 0 0 1\n2 2 2 0 0 1\n"]);
    expect(normals.hasColors).toBe(false);
  });

  test("points that are no numbers are counted and left out", async () => {
    const scan = await read(["1 2 3\nnan 1 2\n4 5 6\n7 inf 8\n"]);
    expect(scan).toMatchObject({ total: 2, dropped: 2 });
  });

  test("the vertices of an OBJ", async () => {
    const scan = await read(["o thing\nv 1 2 3\nv 4 5 6\nvn 0 0 1\nf 1 2 1\n"]);
    expect(scan).toMatchObject({ format: "obj", total: 2 });
  });
});

describe("others", () => {
  test("NPY in single and double precision", async () => {
    for (const [type, body] of [
      ["<f4", Float32Array.from([1, 2, 3, 4, 5, 6])],
      ["<f8", Float64Array.from([1, 2, 3, 4, 5, 6])],
    ] as const) {
      const text = `{'descr': '${type}', 'fortran_order': False, 'shape': (2, 3), }\n`;
      const head = new Uint8Array(10 + text.length);
      head.set([0x93, 0x4e, 0x55, 0x4d, 0x50, 0x59, 1, 0, text.length, 0]);
      head.set(new TextEncoder().encode(text), 10);
      expect(points(await read([head, body]))[1]).toEqual([4, 5, 6]);
    }
  });

  test("PCD, binary with packed colours", async () => {
    const head = [
      "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U",
      "COUNT 1 1 1 1\nWIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA binary\n",
    ].join("\n");
    const view = new DataView(new ArrayBuffer(16));
    [1, 2, 3].forEach((value, i) => {
      view.setFloat32(4 * i, value, true);
    });
    view.setUint32(12, 0x0a1420, true);
    const scan = await read([head, new Uint8Array(view.buffer)]);
    expect(points(scan)).toEqual([[1, 2, 3]]);
    expect([...(scan.colors ?? [])]).toEqual([10, 20, 32]);
  });

  test("LAS, with scale, offset and colours of 16 bits", async () => {
    const head = new DataView(new ArrayBuffer(227));
    new Uint8Array(head.buffer).set(new TextEncoder().encode("LASF"));
    head.setUint8(25, 2);
    head.setUint32(96, 227, true);
    head.setUint8(104, 2);
    head.setUint16(105, 26, true);
    head.setUint32(107, 1, true);
    for (let i = 0; i < 3; i++) {
      head.setFloat64(131 + 8 * i, 0.01, true);
      head.setFloat64(155 + 8 * i, 500000, true);
    }
    const row = new DataView(new ArrayBuffer(26));
    for (const [i, value] of [100, 200, 300].entries()) row.setInt32(4 * i, value, true);
    row.setUint16(20, 65535, true);
    const scan = await read([new Uint8Array(head.buffer), new Uint8Array(row.buffer)]);
    expect(points(scan)[0].map((value) => Math.round(value))).toEqual([500001, 500002, 500003]);
    expect([...(scan.colors ?? [])]).toEqual([255, 0, 0]);
  });

  test("NPY, column after column", async () => {
    const head = npy("<f4", "(2, 3)", true);
    const scan = await read([head, Float32Array.from([1, 4, 2, 5, 3, 6])]);
    expect(points(scan)).toEqual(TWO);
  });

  test("PCD, compressed: field after field, with copies that overlap themselves", async () => {
    const head = [
      "VERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1",
      "WIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA binary_compressed\n",
    ].join("\n");
    const fields = Float32Array.from([1, 4, 2, 5, 3, 6]);
    // 24 literal bytes, one more, and seven copies of it
    const packed = [23, ...new Uint8Array(fields.buffer), 0, 9, (5 << 5) | 0, 0];
    const sizes = Uint32Array.from([packed.length, 32]);
    const scan = await read([head, sizes, Uint8Array.from(packed)]);
    expect(points(scan)).toEqual(TWO);
    expect([...(scan.colors ?? [])]).toEqual([9, 9, 9, 9, 9, 9]);
    const damaged = Uint8Array.from([...packed.slice(0, -1), 200]);
    await expect(read([head, sizes, damaged])).rejects.toThrow("damaged");
  });

  test.each([true, false])("NPZ, deflated: %s", async (deflated) => {
    const members = {
      "labels.npy": [npy("<f4", "(3,)"), Float32Array.from([1, 2, 3])],
      "points.npy": [npy("<f8", "(2, 3)"), Float64Array.from(TWO.flat())],
      "colors.npy": [npy("|u1", "(2, 3)"), Uint8Array.from([1, 2, 3, 4, 5, 6])],
    };
    const scan = await read([await zip(members, deflated)]);
    expect(points(scan)).toEqual(TWO);
    expect([...(scan.colors ?? [])]).toEqual([1, 2, 3, 4, 5, 6]);
    expect(scan.format).toBe("npz");
  });

  test("a zip of something else is refused in words", async () => {
    const file = await zip({ "scan.ply": ["ply"], "words.txt": ["words"] });
    await expect(read([file])).rejects.toThrow("points or xyz");
  });

  test("GLB: parts are placed by their nodes, colours are linear", async () => {
    const view = { byteLength: 24, buffer: 0 };
    const document = {
      scenes: [{ nodes: [0] }],
      nodes: [
        { children: [1], translation: [10, 0, 0] },
        { mesh: 0, rotation: [0, 0, Math.SQRT1_2, Math.SQRT1_2], scale: [2, 2, 2] },
      ],
      meshes: [{ primitives: [{ attributes: { POSITION: 0, COLOR_0: 1 } }] }],
      accessors: [
        { bufferView: 0, componentType: 5126, count: 2, type: "VEC3" },
        { bufferView: 1, componentType: 5126, count: 2, type: "VEC3" },
      ],
      bufferViews: [view, { ...view, byteOffset: 24 }],
    };
    const body = Float32Array.from([1, 0, 0, 0, 0, 3, 0, 0.5, 1, 0, 0.5, 1]);
    const scan = await read([await glb(document, body)]);
    const found = points(scan).map((point) => point.map((value) => Number(value.toFixed(5))));
    expect(found.flat()).toEqual([10, 2, 0, 10, 0, 6].map((value) => expect.closeTo(value, 5)));
    expect([...(scan.colors ?? [])].slice(0, 3)).toEqual([0, 188, 255]);
    const packed = { ...document, extensionsRequired: ["KHR_draco_mesh_compression"] };
    await expect(read([await glb(packed, body)])).rejects.toThrow("compressed");
    await expect(read([await glb(document, body.slice(0, 9))])).rejects.toThrow("ends early");
  });

  test("STL in both kinds: every corner once", async () => {
    const facets = [
      [0, 0, 0, 1, 0, 0, 0, 1, 0],
      [1, 0, 0, 0, 1, 0, -0, 0, 0],
    ];
    const binary = new DataView(new ArrayBuffer(84 + 50 * facets.length));
    binary.setUint32(80, facets.length, true);
    facets.forEach((corners, i) => {
      corners.forEach((value, j) => {
        binary.setFloat32(84 + 50 * i + 12 + 4 * j, value, true);
      });
    });
    const rows = facets.map(
      (c) =>
        `facet normal 0 0 1\n outer loop\n${[0, 3, 6].map((at) => `  vertex ${c.slice(at, at + 3).join(" ")}`).join("\n")}\n endloop\nendfacet`,
    );
    const text = `solid thing\n${rows.join("\n")}\nendsolid thing\n`;
    for (const file of [new Uint8Array(binary.buffer), text]) {
      expect(await read([file])).toMatchObject({ format: "stl", total: 3, high: [1, 1, 0] });
    }
  });

  test("OFF: as many vertices as it says, with colours where it announces them", async () => {
    const plain = await read(["# made by hand\nOFF\n2 1 0\n1 2 3\n4 5 6\n3 0 1 1\n"]);
    expect(points(plain)).toEqual(TWO);
    const colored = await read(["COFF 2 0 0\n1 2 3 255 0 0 255\n4 5 6 0 128 0 255\n"]);
    expect([...(colored.colors ?? [])]).toEqual([255, 0, 0, 0, 128, 0]);
    await expect(read(["4OFF\n2 0 0\n"])).rejects.toThrow("no preview");
  });

  test("LAZ: what its header tells, and that its points are not drawn", async () => {
    const head = new DataView(new ArrayBuffer(227));
    new Uint8Array(head.buffer).set(new TextEncoder().encode("LASF"));
    head.setUint8(25, 2);
    head.setUint8(104, 0x83);
    head.setUint32(107, 12345, true);
    [4, 1, 5, 2, 6, 3].forEach((value, i) => {
      head.setFloat64(179 + 8 * i, value, true);
    });
    const scan = await read([new Uint8Array(head.buffer)]);
    expect(scan).toMatchObject({ format: "laz", total: 12345, low: [1, 2, 3], high: [4, 5, 6] });
    expect(scan.hasColors).toBe(true);
    expect(scan.positions.length).toBe(0);
    expect(scan.note).toMatch("drawn once they are sent");
  });

  test("E57: counts and box from the XML behind the pages", async () => {
    const bounds = ["x", "y", "z"]
      .map((axis, i) => `<${axis}Minimum>${i}</${axis}Minimum><${axis}Maximum>9</${axis}Maximum>`)
      .join("");
    const part = `<points type="CompressedVector" recordCount="30"><prototype/></points>${bounds}`;
    const xml = `<e57Root>${" ".repeat(1000)}${part}${part.replaceAll(">9<", ">11<")}</e57Root>`;
    const content = new Uint8Array(4 * 1020);
    content.set(new TextEncoder().encode("ASTM-E57"));
    content.set(new TextEncoder().encode(xml), 1000);
    const view = new DataView(content.buffer);
    view.setBigUint64(24, 1000n, true);
    view.setBigUint64(32, BigInt(xml.length), true);
    const pages = [0, 1, 2, 3].flatMap((page) => [
      ...content.subarray(1020 * page, 1020 * (page + 1)),
      ...[1, 2, 3, 4],
    ]);
    const scan = await read([Uint8Array.from(pages)]);
    expect(scan).toMatchObject({ format: "e57", total: 60, low: [0, 1, 2], high: [11, 11, 11] });
  });

  test.each([
    ["an empty file", [""], "empty"],
    ["words", ["hello, this is no scan\nnot at all\n"], "no point"],
    ["half a zip", [Uint8Array.from([0x50, 0x4b, 3, 4, 0, 0])], "ends early"],
    ["bytes of no known kind", [Uint8Array.from([0, 1, 2, 3])], "no preview of this kind"],
  ] as [string, Part[], string][])("%s is refused in words", async (_, parts, words) => {
    await expect(read(parts)).rejects.toThrow(words);
  });
});

test("of many points an even choice is kept, and all are counted", async () => {
  const lines = Array.from({ length: 10_000 }, (_, i) => `${i} ${-i} 0.5`).join("\n");
  const scan = await read([lines], 300);
  expect(scan).toMatchObject({ total: 10_000, low: [0, -9999, 0.5], high: [9999, 0, 0.5] });
  const xs = points(scan).map(([x]) => x);
  expect(xs.length).toBeGreaterThan(150);
  expect(xs.length).toBeLessThanOrEqual(300);
  const steps = xs.slice(1).map((x, i) => x - xs[i]);
  expect(Math.max(...steps)).toBe(Math.min(...steps));
});
