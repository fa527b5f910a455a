// What the canvas shows: the mesh and one or two sets of samples, as points or as strokes.
import {Color, DepthTexture, DirectionalLight, DoubleSide, HemisphereLight, Mesh, MeshBasicMaterial, MeshLambertMaterial, PerspectiveCamera, Scene, Spherical, Vector3, WebGLRenderer, WebGLRenderTarget} from 'three';
import {OrbitControls} from 'three/addons/controls/OrbitControls.js';

import {coloursOf} from './colours.js';
import {makePoints} from './points.js';
import {Strokes} from './strokes.js';

/**
 * A scene's frame: the mesh's centre at the origin, half its diagonal 1, so that depths keep
 * exact.
 */
export function frameOf(min, max) {
  const centre = min.map((low, axis) => (low + max[axis]) / 2);
  const radius = Math.hypot(...min.map((low, axis) => max[axis] - low)) / 2;
  return {centre, radius: radius > 0 ? radius : 1};
}

function framed({position, offset}, {centre, radius}) {
  const placed = new Float32Array(position.length);
  for (let i = 0; i < placed.length; ++i) {
    placed[i] = (position[i] + (offset[i % 3] - centre[i % 3])) / radius;
  }
  return placed;
}

/** Where the light stands, as the eye sees it: over its shoulder. */
const LAMP = new Vector3(-0.3, 0.6, 0.7);

function litScene() {
  const scene = new Scene();
  scene.add(new HemisphereLight(0xffffff, 0x667788, 1.6));
  const sun = new DirectionalLight(0xffffff, 1.6);
  scene.add(sun);
  return {scene, sun};
}

const SIGHT = 40 * Math.PI / 180;  // Angle of view along the shorter side.
const HOME = new Vector3(0.5, 0.35, 1).normalize().multiplyScalar(2.9);

export class View {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.renderer = new WebGLRenderer({canvas, antialias: true});
    this.renderer.autoClear = false;
    this.camera = new PerspectiveCamera(40, 1, 0.02, 30);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.minDistance = 0.05;
    this.controls.maxDistance = 20;
    this.controls.addEventListener('change', () => this.draw());
    this.settings =
        {mode: 'points', colour: 'normal', mesh: true, compare: false, point: 0.6, stroke: 3};
    this.frame = {centre: [0, 0, 0], radius: 1};
    this.lattice = {origin: [0, 0, 0], edge: 1};
    this.sets = [];  // {samples, points, strokes}: stratified first, then uniform.
    this.#makeMeshScenes();
    this.home();
    new ResizeObserver(() => this.draw()).observe(canvas);
    canvas.addEventListener('webglcontextrestored', () => this.draw());
  }

  #makeMeshScenes() {
    // The surface lies a little behind its samples, which would flicker otherwise.
    const offset =
        {side: DoubleSide, polygonOffset: true, polygonOffsetFactor: 1.5, polygonOffsetUnits: 4};
    const {scene, sun} = litScene();
    this.meshScene = scene;
    this.sun = sun;
    this.depthScene = new Scene();
    this.mesh = new Mesh(undefined, new MeshLambertMaterial({color: 0xb8bcc4, ...offset}));
    this.depthMesh = new Mesh(undefined, new MeshBasicMaterial({colorWrite: false, ...offset}));
    this.meshScene.add(this.mesh);
    this.depthScene.add(this.depthMesh);
    this.hasMesh = false;
    this.mesh.visible = this.depthMesh.visible = false;
    this.depths = new WebGLRenderTarget(1, 1, {depthTexture: new DepthTexture(1, 1)});
  }

  /** @param {import('three').BufferGeometry|null} geometry */
  setMesh(geometry, frame) {
    this.#setFrame(frame);
    if (this.hasMesh) this.mesh.geometry.dispose();
    this.hasMesh = geometry !== null;
    if (geometry) {
      const {centre, radius} = frame;
      const placed = geometry.clone().translate(...centre.map((c) => -c));
      placed.scale(1 / radius, 1 / radius, 1 / radius);
      this.mesh.geometry = this.depthMesh.geometry = placed;
    }
    this.setSamples([], this.lattice);
  }

  #setFrame(frame) {
    if (frame) this.frame = frame;
  }

  /**
   * @param {object[]} samples stratified, and uniform if there are
   * @param {{origin: number[], edge: number}} lattice
   * @param {object} [frame] where there is no mesh to have set it
   */
  setSamples(samples, lattice, frame) {
    this.#setFrame(frame);
    this.lattice = lattice;
    for (const set of this.sets) this.#forget(set);
    this.sets = samples.map((one) => ({samples: one, centres: framed(one, this.frame)}));
    this.draw();
  }

  #forget(set) {
    for (const part of [set.points, set.strokes?.mesh]) {
      part?.geometry.dispose();
      part?.material.dispose();
    }
    set.points = set.strokes = undefined;
  }

  configure(changes) {
    if (changes.colour && changes.colour !== this.settings.colour) this.sets.forEach(this.#forget);
    Object.assign(this.settings, changes);
    this.draw();
  }

  home() {
    this.camera.position.copy(HOME);
    this.controls.target.set(0, 0, 0);
    this.controls.update();
    this.draw();
  }

  /** Turns around the middle, by radians. */
  orbit(right, up) {
    const arm = this.camera.position.clone().sub(this.controls.target);
    const angles = new Spherical().setFromVector3(arm);
    angles.theta += right;
    angles.phi += up;
    angles.makeSafe();
    this.camera.position.setFromSpherical(angles).add(this.controls.target);
    this.controls.update();
  }

  /** @param {number} factor of the distance */
  zoom(factor) {
    const arm = this.camera.position.clone().sub(this.controls.target);
    arm.setLength(Math.min(Math.max(arm.length() * factor, 0.05), 20));
    this.camera.position.copy(this.controls.target).add(arm);
    this.controls.update();
  }

  /** Draws before the next picture. */
  draw() {
    this.pending ??= requestAnimationFrame(() => {
      this.pending = undefined;
      this.#drawNow();
    });
  }

  #drawNow() {
    const {clientWidth: width, clientHeight: height} = this.canvas;
    if (width === 0 || height === 0) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.background = new Color(getComputedStyle(this.canvas).backgroundColor);
    this.renderer.setClearColor(this.background, 1);
    this.renderer.clear();
    const shown = this.settings.compare && this.sets.length > 1 ? [this.sets[1], this.sets[0]] :
                                                                  [this.sets[0]];
    const part = width / shown.length;
    this.camera.aspect = part / height;
    // The whole model fits the shorter side.
    const across = Math.tan(SIGHT / 2) / Math.min(1, this.camera.aspect);
    this.camera.fov = 2 * Math.atan(across) * 180 / Math.PI;
    this.camera.updateProjectionMatrix();
    this.sun.position.copy(LAMP).applyQuaternion(this.camera.quaternion);
    this.mesh.visible = this.hasMesh && this.settings.mesh;
    if (this.settings.mode === 'strokes' && this.sets.length) this.#drawDepths(part, height);
    shown.forEach((set, i) => {
      this.renderer.setViewport(i * part, 0, part, height);
      this.renderer.setScissor(i * part, 0, part, height);
      this.renderer.setScissorTest(true);
      this.#drawSet(set, part, height);
      this.renderer.setScissorTest(false);
    });
    this.renderer.setViewport(0, 0, width, height);
  }

  #drawSet(set, width, height) {
    if (set && this.settings.mode === 'strokes') return this.#drawStrokes(set);
    this.renderer.render(this.meshScene, this.camera);
    if (set) this.renderer.render(this.#pointsOf(set, height), this.camera);
  }

  #pointsOf(set, height) {
    set.points ??=
        makePoints(set.centres, coloursOf(set.samples, this.settings.colour, this.lattice));
    const {diameter, pixelsPerUnit} = set.points.material.uniforms;
    diameter.value = this.settings.point * this.lattice.edge / this.frame.radius;
    pixelsPerUnit.value =
        height * this.renderer.getPixelRatio() / 2 / Math.tan(this.camera.fov * Math.PI / 360);
    return set.points;
  }

  /** The depth of the surface; without a mesh, that of discs at the samples that overlap. */
  #drawDepths(width, height) {
    const ratio = this.renderer.getPixelRatio();
    this.depths.setSize(
        Math.max(1, Math.floor(width * ratio)), Math.max(1, Math.floor(height * ratio)));
    this.renderer.setRenderTarget(this.depths);
    this.renderer.clear();
    this.depthMesh.visible = this.hasMesh;
    if (this.hasMesh) {
      this.renderer.render(this.depthScene, this.camera);
    } else {
      const discs = this.#pointsOf(this.sets[0], height);
      discs.material.uniforms.diameter.value = 2 * this.lattice.edge / this.frame.radius;
      this.renderer.render(discs, this.camera);
    }
    this.renderer.setRenderTarget(null);
  }

  #drawStrokes(set) {
    const colours = () => coloursOf(set.samples, this.settings.colour, this.lattice);
    set.strokes ??= new Strokes(set.centres, set.samples.normal, colours());
    set.strokes.sort(this.camera.position);
    const edge = this.lattice.edge / this.frame.radius;
    const {depths, range, slack, size} = set.strokes.uniforms;
    depths.value = this.depths.depthTexture;
    range.value.set(this.camera.near, this.camera.far);
    slack.value = 0.75 * edge;
    size.value.set(this.settings.stroke * edge, this.settings.stroke * edge * 0.45);
    this.renderer.render(set.strokes.mesh, this.camera);
  }
}
