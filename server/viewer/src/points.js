// Samples as round points.
import {BufferAttribute, BufferGeometry, Points, ShaderMaterial} from 'three';

const VERTEX = `
  uniform float diameter;      // Of a point, in units of the scene.
  uniform float pixelsPerUnit; // At distance 1.
  attribute vec3 tint;
  varying vec3 colour;
  varying float edge;
  void main() {
    vec4 seen = modelViewMatrix * vec4(position, 1.0);
    gl_Position = projectionMatrix * seen;
    gl_PointSize = max(1.5, diameter * pixelsPerUnit / -seen.z);
    edge = 2.0 / gl_PointSize;
    colour = tint;
  }`;

const FRAGMENT = `
  varying vec3 colour;
  varying float edge;
  void main() {
    float r = length(gl_PointCoord - 0.5) * 2.0;
    if (r > 1.0) discard;
    float rim = smoothstep(1.0 - 2.0 * edge, 1.0, r) * smoothstep(0.5, 0.2, edge);
    gl_FragColor = vec4(colour * (1.0 - 0.45 * rim), 1.0);
  }`;

/**
 * @param {Float32Array} centres in the scene's frame, three numbers a sample
 * @param {Float32Array} tints
 * @returns {Points} with the uniforms diameter and pixelsPerUnit
 */
export function makePoints(centres, tints) {
  const geometry = new BufferGeometry();
  geometry.setAttribute('position', new BufferAttribute(centres, 3));
  geometry.setAttribute('tint', new BufferAttribute(tints, 3));
  const material = new ShaderMaterial({
    vertexShader: VERTEX,
    fragmentShader: FRAGMENT,
    uniforms: {diameter: {value: 0.01}, pixelsPerUnit: {value: 1000}},
  });
  const points = new Points(geometry, material);
  points.frustumCulled = false;
  return points;
}
