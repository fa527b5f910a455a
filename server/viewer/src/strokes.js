// Samples as strokes of a brush, after section 3.1 of the paper: the surface goes to a depth buffer
// first; each sample that it does not hide becomes a rectangle on the surface whose opacity is a
// stroke's, and the strokes are blended over each other, the furthest first.
import {BufferAttribute, DynamicDrawUsage, InstancedBufferAttribute, InstancedBufferGeometry, Mesh, ShaderMaterial, Vector2, Vector3} from 'three';

import {randomFrom} from './random.js';

const VERTEX = `
  uniform sampler2D depths;  // Of the surface, as this camera sees it.
  uniform vec2 range;        // The camera's near and far.
  uniform float slack;       // How far behind the surface a sample still counts as on it.
  uniform vec2 size;         // A stroke's length and width, in units of the scene.
  attribute vec3 centre, facing, tint;
  attribute float chance;    // 0 to 1, the sample's own.
  varying vec2 at;
  varying vec4 colour;
  varying float bristles;

  float distanceOf(float depth) {
    return range.x * range.y / (range.y - depth * (range.y - range.x));
  }
  void main() {
    vec4 clip = projectionMatrix * modelViewMatrix * vec4(centre, 1.0);
    vec3 place = clip.xyz / clip.w * 0.5 + 0.5;
    vec3 toEye = normalize(cameraPosition - centre);
    // A sample that faces away is hidden on a closed surface and seen on an open one: it gets hardly
    // any slack, and none where rounding puts it beyond the outline.
    float side = dot(facing, toEye) < 0.0 ? -1.0 : 1.0;
    vec3 n = side * facing;
    float depth = texture2D(depths, place.xy).r;
    bool hidden = clip.w > distanceOf(depth) + (side > 0.0 ? slack : 0.02 * slack) ||
        (side < 0.0 && depth == 1.0);
    if (hidden || any(lessThan(place.xy, vec2(-0.1))) || any(greaterThan(place.xy, vec2(1.1)))) {
      gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
      return;
    }
    // Strokes hang down the surface, each a little askew.
    vec3 down = vec3(0.0, -1.0, 0.0) + 0.05 * vec3(1.0, 0.0, 0.0);
    vec3 along = normalize(down - n * dot(down, n));
    vec3 across = cross(n, along);
    float askew = (chance - 0.5) * 0.9;
    vec3 x = along * cos(askew) + across * sin(askew), y = cross(n, x);
    vec3 corner = centre + x * position.x * size.x * (0.8 + 0.4 * chance) + y * position.y * size.y;
    gl_Position = projectionMatrix * modelViewMatrix * vec4(corner, 1.0);
    vec3 lamp = normalize((vec4(-0.3, 0.6, 0.7, 0.0) * viewMatrix).xyz);  // Over the eye's shoulder.
    float light = 0.55 + 0.5 * max(0.0, dot(n, lamp));
    float shade = light * (0.85 + 0.3 * fract(chance * 7.0));
    colour = vec4(tint * shade, smoothstep(0.0, 0.15, dot(n, toEye)));
    at = position.xy * 2.0;
    bristles = chance * 97.0;
  }`;

const FRAGMENT = `
  varying vec2 at;  // -1 to 1 along and across the stroke.
  varying vec4 colour;
  varying float bristles;
  float hash(float n) { return fract(sin(n) * 43758.5453); }
  void main() {
    float lane = (at.y * 0.5 + 0.5) * 7.0, i = floor(lane);
    float hair = mix(hash(i + bristles), hash(i + 1.0 + bristles), smoothstep(0.0, 1.0, lane - i));
    float ends = smoothstep(1.0, 0.55, abs(at.x) + 0.35 * hair * step(0.0, at.x));
    float sides = smoothstep(1.0, 0.7, abs(at.y));
    float opacity = 0.8 * colour.a * ends * sides * (0.45 + 0.55 * hair);
    gl_FragColor = vec4(colour.rgb * (0.8 + 0.35 * hair), opacity);
  }`;

const CORNERS = new Float32Array([-0.5, -0.5, 0, 0.5, -0.5, 0, 0.5, 0.5, 0, -0.5, 0.5, 0]);

/** The instances' values in the order of the samples, from which each order is copied. */
class Instances {
  constructor(geometry, columns) {
    this.columns = Object.entries(columns).map(([name, values]) => {
      const size = name === 'chance' ? 1 : 3;
      const attribute = new InstancedBufferAttribute(values.slice(), size);
      geometry.setAttribute(name, attribute.setUsage(DynamicDrawUsage));
      return {values, size, attribute};
    });
  }

  /** @param {Uint32Array} order which sample stands where */
  arrange(order) {
    for (const {values, size, attribute} of this.columns) {
      const into = attribute.array;
      for (let i = 0; i < order.length; ++i) {
        for (let k = 0; k < size; ++k) into[size * i + k] = values[size * order[i] + k];
      }
      attribute.needsUpdate = true;
    }
  }
}

const STEPS = 4096;  // Of distance: strokes in one step keep their order.

/** The samples by their distance from `eye`, in linear time: it is done for every picture. */
function furthestFirst(centres, eye) {
  const count = centres.length / 3, distances = new Float32Array(count);
  let most = 0;
  for (let i = 0; i < count; ++i) {
    distances[i] =
        Math.hypot(centres[3 * i] - eye.x, centres[3 * i + 1] - eye.y, centres[3 * i + 2] - eye.z);
    most = Math.max(most, distances[i]);
  }
  const starts = new Uint32Array(STEPS + 1);
  const steps = Uint16Array.from(
      distances, (distance) => Math.floor((1 - distance / (most || 1)) * (STEPS - 1)));
  for (const step of steps) ++starts[step + 1];
  for (let step = 0; step < STEPS; ++step) starts[step + 1] += starts[step];
  const order = new Uint32Array(count);
  for (let i = 0; i < count; ++i) order[starts[steps[i]]++] = i;
  return order;
}

function makeMaterial() {
  return new ShaderMaterial({
    vertexShader: VERTEX,
    fragmentShader: FRAGMENT,
    transparent: true,
    depthTest: false,
    depthWrite: false,
    side: 2,
    uniforms: {
      depths: {value: null},
      range: {value: new Vector2()},
      slack: {value: 0},
      size: {value: new Vector2(0.02, 0.01)},
    },
  });
}

/** The strokes of one set of samples. */
export class Strokes {
  /**
   * @param {Float32Array} centres in the scene's frame
   * @param {Float32Array} normals
   * @param {Float32Array} tints
   */
  constructor(centres, normals, tints) {
    const geometry = new InstancedBufferGeometry();
    geometry.setAttribute('position', new BufferAttribute(CORNERS, 3));
    geometry.setIndex([0, 1, 2, 0, 2, 3]);
    const count = centres.length / 3;
    const random = randomFrom(1);
    const chance = new Float32Array(count).map(random);
    this.centres = centres;
    this.instances =
        new Instances(geometry, {centre: centres, facing: normals, tint: tints, chance});
    geometry.instanceCount = count;
    this.mesh = new Mesh(geometry, makeMaterial());
    this.mesh.frustumCulled = false;
    this.sortedFrom = new Vector3(NaN, NaN, NaN);
  }

  get uniforms() {
    return this.mesh.material.uniforms;
  }

  /** Puts the furthest from `eye` first. */
  sort(eye) {
    if (this.sortedFrom.equals(eye)) return;
    this.sortedFrom.copy(eye);
    this.instances.arrange(furthestFirst(this.centres, eye));
  }
}
