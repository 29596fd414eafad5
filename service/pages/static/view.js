// A surface in space: coloured by a number at each node, turned by mouse, touch or keys.

import * as THREE from "./vendor/three.module.js";
import { rgb, share } from "./scale.js";

/** Whether this browser can draw in 3-D at all. */
export const possible = () => {
  try {
    return Boolean(document.createElement("canvas").getContext("webgl2"));
  } catch {
    return false;
  }
};

export class View {
  constructor(canvas, surface) {
    this.canvas = canvas;
    this.points = surface.points.flat();
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true, preserveDrawingBuffer: true });
    this.scene = new THREE.Scene();
    this.geometry = new THREE.BufferGeometry();
    this.geometry.setAttribute("position", new THREE.Float32BufferAttribute(this.points, 3));
    this.geometry.setAttribute("color", new THREE.Float32BufferAttribute(new Float32Array(this.points.length).fill(0.5), 3));
    this.geometry.setIndex(surface.triangles.flat());
    this.geometry.computeVertexNormals();
    this.geometry.computeBoundingSphere();
    this.mesh = new THREE.Mesh(this.geometry, new THREE.MeshLambertMaterial({ vertexColors: true, side: THREE.DoubleSide, polygonOffset: true, polygonOffsetFactor: 2, polygonOffsetUnits: 40 }));
    this.dots = new THREE.Points(new THREE.BufferGeometry(), new THREE.PointsMaterial({ size: 7, sizeAttenuation: false, color: 0xd55e00 }));
    this.scene.add(this.mesh, this.dots, new THREE.HemisphereLight(0xffffff, 0xc8c8c8, 2.6));
    this.lamp = new THREE.DirectionalLight(0xffffff, 0.9);
    this.scene.add(this.lamp);
    this.camera = new THREE.PerspectiveCamera(30, 1, 1, 10_000);
    this.camera.up.set(0, 0, 1);
    this.home();
    this.listen();
    new ResizeObserver(() => this.draw()).observe(canvas.parentElement);
  }

  home() {
    const { center, radius } = this.geometry.boundingSphere;
    this.centre = center.clone();
    this.radius = radius;
    this.around = -0.9;
    this.above = 0.25;
    this.far = radius * 4.1;
  }

  turn(dx, dy) {
    this.around -= dx;
    this.above = Math.max(-1.5, Math.min(1.5, this.above + dy));
    this.draw();
  }

  nearer(factor) {
    this.far = Math.max(this.radius * 0.3, Math.min(this.radius * 12, this.far * factor));
    this.draw();
  }

  listen() {
    const { canvas } = this;
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (event.buttons) this.turn(event.movementX * 0.008, event.movementY * 0.008);
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.nearer(Math.exp(event.deltaY * 0.001));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const ways = {
        ArrowLeft: () => this.turn(-0.1, 0), ArrowRight: () => this.turn(0.1, 0),
        ArrowUp: () => this.turn(0, -0.1), ArrowDown: () => this.turn(0, 0.1),
        "+": () => this.nearer(0.9), "=": () => this.nearer(0.9), "-": () => this.nearer(1.1),
        Home: () => {
          this.home();
          this.draw();
        },
      };
      if (!(event.key in ways)) return;
      event.preventDefault();
      ways[event.key]();
    });
  }

  /** Colour the nodes by values within a span; move them by `shift` (mm, three a node). */
  paint(values, span, shift = null) {
    const colours = this.geometry.getAttribute("color");
    const position = this.geometry.getAttribute("position");
    const seen = new THREE.Color();
    for (let i = 0; i < values.length; i += 1) {
      const [r, g, b] = rgb(share(values[i], span));
      seen.setRGB(r / 255, g / 255, b / 255, THREE.SRGBColorSpace);
      colours.setXYZ(i, seen.r, seen.g, seen.b);
      for (let k = 0; k < 3; k += 1) position.array[3 * i + k] = this.points[3 * i + k] + (shift ? shift[3 * i + k] : 0);
    }
    colours.needsUpdate = true;
    position.needsUpdate = true;
    this.geometry.computeVertexNormals();
    this.draw();
  }

  /** Mark nodes: those that a scan measured, in one colour or each in its own ([r, g, b]). */
  mark(nodes, colours = null) {
    const position = this.geometry.getAttribute("position");
    this.dots.geometry.dispose();
    this.dots.geometry = new THREE.BufferGeometry();
    this.dots.geometry.setAttribute("position", new THREE.Float32BufferAttribute(
      nodes.flatMap((n) => [position.getX(n), position.getY(n), position.getZ(n)]), 3));
    const seen = new THREE.Color();
    if (colours) {
      this.dots.geometry.setAttribute("color", new THREE.Float32BufferAttribute(
        colours.flatMap(([r, g, b]) => seen.setRGB(r / 255, g / 255, b / 255, THREE.SRGBColorSpace).toArray()), 3));
    }
    this.dots.material.vertexColors = Boolean(colours);
    this.dots.material.color.set(colours ? 0xffffff : 0xd55e00);
    this.dots.material.size = colours ? 11 : 7;
    this.dots.material.needsUpdate = true;
    this.draw();
  }

  /** Draw with the next frame, once, whatever changed until then. */
  draw() {
    if (this.due) return;
    this.due = true;
    requestAnimationFrame(() => {
      this.due = false;
      this.render();
    });
  }

  render() {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(2, devicePixelRatio));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    const across = Math.cos(this.above);
    const from = new THREE.Vector3(across * Math.cos(this.around), across * Math.sin(this.around), Math.sin(this.above));
    this.camera.position.copy(this.centre).addScaledVector(from, this.far);
    this.camera.lookAt(this.centre);
    this.camera.updateProjectionMatrix();
    this.lamp.position.copy(this.camera.position).add(new THREE.Vector3(0, 0, this.radius));
    this.renderer.render(this.scene, this.camera);
  }
}
