#include "io/splat_canvas.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace strata::io {
namespace {

constexpr float kNothing = std::numeric_limits<float>::infinity();

// The least cosine between a disc's normal and the line of sight.
constexpr double kLeastTilt = 0.18;

Vec3 FacingViewer(Vec3 normal, Vec3 centre) {
  const Vec3 toward = centre * (-1 / Norm(centre));
  if (Dot(normal, toward) < 0) normal = normal * -1;
  const double lack = kLeastTilt - Dot(normal, toward);
  if (lack > 0) normal = normal + toward * lack;
  return normal * (1 / Norm(normal));
}

// sRGB's curve, near enough, without pow: the picture must not depend on the C library.
std::uint8_t Stored(float light) {
  return static_cast<std::uint8_t>(std::sqrt(std::clamp(light, 0.0f, 1.0f)) * 255.0f + 0.5f);
}

}  // namespace

SplatCanvas::SplatCanvas(int width, int height, const Camera& camera)
    : width_(width * kFine), height_(height * kFine), camera_(camera) {
  camera_.scale *= kFine;
  camera_.centre_u *= kFine;
  camera_.centre_v *= kFine;
  const std::size_t n = static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_);
  depth_.assign(n, kNothing);
  light_.assign(n, Light{});
}

void SplatCanvas::Draw(const Disc& disc) {
  const Vec3 c = disc.centre;
  const Vec3 n = FacingViewer(disc.normal, c);
  const double per_unit = camera_.scale / c.z;
  // Never smaller than the fine image shows.
  const double radius = std::max(disc.radius, 0.75 / per_unit);
  const double u = camera_.centre_u + c.x * per_unit, v = camera_.centre_v - c.y * per_unit;
  const double reach = radius * per_unit * 1.2 + 1;
  const int x0 = std::max(0, static_cast<int>(std::max(0.0, u - reach)));
  const int y0 = std::max(0, static_cast<int>(std::max(0.0, v - reach)));
  const int x1 = static_cast<int>(std::min(width_ - 1.0, u + reach));
  const int y1 = static_cast<int>(std::min(height_ - 1.0, v + reach));
  const double plane = Dot(n, c);
  for (int y = y0; y <= y1; ++y) {
    for (int x = x0; x <= x1; ++x) {
      const Vec3 ray{(x + 0.5 - camera_.centre_u) / camera_.scale,
                     (camera_.centre_v - y - 0.5) / camera_.scale, 1};
      const double depth = plane / Dot(n, ray);
      if (!(depth > 0) || Norm2(ray * depth - c) > radius * radius) continue;
      const std::size_t at = static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) +
                             static_cast<std::size_t>(x);
      const auto biased = static_cast<float>(depth + disc.bias);
      if (!(biased < depth_[at])) continue;
      depth_[at] = biased;
      light_[at] = disc.light;
    }
  }
}

// How much nearer the neighbour is, at least 0; what lies outside is as far.
float SplatCanvas::DepthStep(int x, int y, int dx, int dy) const {
  const int nx = std::clamp(x + dx, 0, width_ - 1), ny = std::clamp(y + dy, 0, height_ - 1);
  const auto at = [&](int i, int j) {
    return depth_[static_cast<std::size_t>(j) * static_cast<std::size_t>(width_) +
                  static_cast<std::size_t>(i)];
  };
  const float beside = at(nx, ny), here = at(x, y);
  return beside < here ? here - beside : 0.0f;
}

void SplatCanvas::DarkenCrevices(double scale) {
  static constexpr std::array<std::array<int, 2>, 8> kAround = {
      {{1, 0}, {-1, 0}, {0, 1}, {0, -1}, {1, 1}, {1, -1}, {-1, 1}, {-1, -1}}};
  const int step = std::max(2, height_ / 380);
  const auto inverse = static_cast<float>(1 / scale);
  for (int y = 0; y < height_; ++y) {
    for (int x = 0; x < width_; ++x) {
      const std::size_t at = static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) +
                             static_cast<std::size_t>(x);
      if (depth_[at] == kNothing) continue;
      float sum = 0;
      for (const auto& [dx, dy] : kAround) {
        for (const int far : {1, 2, 4}) {
          const float s = DepthStep(x, y, dx * far * step, dy * far * step) * inverse;
          sum += s / (1 + s);  // A cliff counts once, however high.
        }
      }
      light_[at] = light_[at] * (1 - 0.8f * std::min(1.0f, sum / 16));
    }
  }
}

std::vector<std::uint8_t> SplatCanvas::Develop() const {
  const int width = width_ / kFine, height = height_ / kFine;
  std::vector<std::uint8_t> pixels;
  pixels.reserve(static_cast<std::size_t>(width) * static_cast<std::size_t>(height) * 3);
  for (int y = 0; y < height; ++y) {
    const Light background = Mix({0.97f, 0.98f, 0.99f}, {0.80f, 0.84f, 0.89f},
                                 static_cast<float>(y) / static_cast<float>(height));
    for (int x = 0; x < width; ++x) {
      Light sum;
      for (int k = 0; k < kFine * kFine; ++k) {
        const std::size_t at =
            static_cast<std::size_t>(y * kFine + k / kFine) * static_cast<std::size_t>(width_) +
            static_cast<std::size_t>(x * kFine + k % kFine);
        sum = sum + (depth_[at] == kNothing ? background : light_[at]);
      }
      const Light mean = sum * (1.0f / (kFine * kFine));
      for (const float channel : {mean.r, mean.g, mean.b}) pixels.push_back(Stored(channel));
    }
  }
  return pixels;
}

}  // namespace strata::io
