// Discs in space, drawn with a depth buffer.
#pragma once

#include <cstdint>
#include <vector>

#include "core/vec3.h"

namespace strata::io {

/// Red, green, blue in light, not in stored sRGB values; 0 to 1.
struct Light {
  float r = 0, g = 0, b = 0;
  friend Light operator+(Light left, Light right) {
    return {left.r + right.r, left.g + right.g, left.b + right.b};
  }
  friend Light operator*(Light light, float s) { return {light.r * s, light.g * s, light.b * s}; }
};
/// a at 0, b at 1.
inline Light Mix(Light a, Light b, float t) { return a * (1 - t) + b * t; }

/// A pinhole camera. In its space x points right, y up, and z away from the viewer: the depth.
struct Camera {
  Vec3 right, up, back;  ///< Unit vectors in world space.
  double distance = 0;   ///< From the viewer to the world's origin.
  double scale = 1;      ///< Image units per unit of x / z.
  double centre_u = 0, centre_v = 0;

  Vec3 ToView(Vec3 p) const { return {Dot(right, p), Dot(up, p), distance - Dot(back, p)}; }
  Vec3 DirectionToView(Vec3 d) const { return {Dot(right, d), Dot(up, d), -Dot(back, d)}; }
};

/// Depth and light of every point of an image that is kFine times finer than the pixels.
class SplatCanvas {
 public:
  static constexpr int kFine = 3;

  SplatCanvas(int width, int height, const Camera& camera);

  /// A disc, all in the camera's space; what is nearer than `centre` by less than `bias` still
  /// hides it. A disc seen from its edge is turned so far that it does not vanish.
  struct Disc {
    Vec3 centre, normal;
    double radius = 0, bias = 0;
    Light light;
  };
  void Draw(const Disc& disc);

  /// Darkens what has something nearer beside it, as corners and outlines do; `scale` is the step
  /// in depth that counts as large.
  void DarkenCrevices(double scale);

  /// Eight bits each of red, green and blue in sRGB, row by row from the top; where nothing was
  /// drawn lies a pale background.
  std::vector<std::uint8_t> Develop() const;

 private:
  float DepthStep(int x, int y, int dx, int dy) const;

  int width_, height_;  // Of the fine image.
  Camera camera_;
  std::vector<float> depth_;  // Infinite where nothing was drawn.
  std::vector<Light> light_;
};

}  // namespace strata::io
