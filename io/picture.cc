#include "io/picture.h"

#include <png.h>

#include <algorithm>
#include <cmath>
#include <new>
#include <utility>
#include <vector>

#include "io/atomic_file.h"
#include "io/splat_canvas.h"

namespace strata::io {
namespace {

// Discs a little apart, on a paler surface of discs that overlap; in units of the edge.
constexpr double kDiscRadius = 0.31;
constexpr double kSurfaceRadius = 1.12;
// How far the surface lies behind the discs. More where nothing says how it slopes.
constexpr double kSurfaceBias = 0.7;
constexpr double kSurfaceBiasNoNormals = 2.2;
// The viewer's distance, in half extents: enough perspective to look natural.
constexpr double kViewDistance = 5;
constexpr double kMargin = 0.06;

Vec3 Unit(Vec3 v) { return v * (1 / Norm(v)); }

// The samples moved and scaled into the cube [-1, 1]^3.
struct Scene {
  std::vector<Vec3> position;
  double edge = 0;
};

Result<Scene> NormalizedScene(const SampleColumns& samples, double edge) {
  Bounds box;
  bool finite = true;
  for (const Vec3& p : samples.position) {
    box.Add(p);
    finite = finite && Norm2(p * 0) == 0;  // Bounds pass over what is not a number.
  }
  if (!finite) return Fail(ErrorCode::kInternal, "a sample's position is not finite");
  // Halved before adding and subtracting: nothing finite overflows.
  const Vec3 centre = box.min * 0.5 + box.max * 0.5, half = box.max * 0.5 - box.min * 0.5;
  double extent = std::max({half.x, half.y, half.z});
  if (extent == 0) extent = edge;
  Scene scene;
  scene.position.reserve(samples.size());
  for (const Vec3& p : samples.position) {
    const Vec3 d = p - centre;
    scene.position.push_back({d.x / extent, d.y / extent, d.z / extent});
  }
  // A single cell larger than everything would fill the view.
  scene.edge = std::min(edge / extent, 1.0);
  return scene;
}

Camera LookAt(const PictureOptions& options) {
  Vec3 up, side;
  up[options.up_axis] = 1;
  side[options.up_axis == 0 ? 1 : 0] = -1;
  for (int turn = 0; turn < options.quarter_turns; ++turn) side = Cross(up, side);
  const Vec3 front = Cross(side, up);
  Camera camera;
  camera.back = Unit(front + side * 0.55 + up * 0.42);
  camera.right = Unit(Cross(up, camera.back));
  camera.up = Cross(camera.back, camera.right);
  camera.distance = kViewDistance;
  return camera;
}

// Chooses scale and centre so that all samples fill the picture.
void Frame(Camera& camera, const Scene& scene, const PictureOptions& options) {
  Bounds seen;
  for (const Vec3& p : scene.position) {
    const Vec3 v = camera.ToView(p);
    const double rim = scene.edge * kDiscRadius;
    seen.Add({(v.x - rim) / v.z, (v.y - rim) / v.z, 0});
    seen.Add({(v.x + rim) / v.z, (v.y + rim) / v.z, 0});
  }
  const double across = (1 - 2 * kMargin) * options.width / (seen.max.x - seen.min.x);
  const double upward = (1 - 2 * kMargin) * options.height / (seen.max.y - seen.min.y);
  camera.scale = std::min(across, upward);
  camera.centre_u = options.width * 0.5 - camera.scale * (seen.min.x + seen.max.x) / 2;
  camera.centre_v = options.height * 0.5 + camera.scale * (seen.min.y + seen.max.y) / 2;
}

// Light and shadow on a surface of normal `n` in the camera's space, 0 to 1.
float Shade(Vec3 n, Vec3 to_viewer) {
  if (Dot(n, to_viewer) < 0) n = n * -1;
  static const Vec3 kKey = Unit({-0.45, 0.75, -0.75}), kFill = Unit({0.8, 0.1, -0.5});
  const double key = std::max(0.0, Dot(n, kKey)), fill = std::max(0.0, Dot(n, kFill));
  return static_cast<float>(std::min(1.0, 0.05 + 0.85 * key + 0.25 * fill));
}

Light DiscLight(float shade) {
  static constexpr Light kDark{0.020f, 0.012f, 0.110f}, kMiddle{0.015f, 0.12f, 0.45f},
      kBright{0.05f, 0.50f, 0.72f};
  return shade < 0.5f ? Mix(kDark, kMiddle, shade * 2) : Mix(kMiddle, kBright, shade * 2 - 1);
}

Light SurfaceLight(float shade) {
  static constexpr Light kDark{0.16f, 0.20f, 0.29f}, kBright{1.00f, 0.99f, 0.97f};
  return Mix(kDark, kBright, shade);
}

class Painter {
 public:
  Painter(const SampleColumns& samples, const Scene& scene, const Camera& camera)
      : samples_(samples), scene_(scene), camera_(camera) {}

  void DrawSurface(SplatCanvas& canvas) const {
    const double bias = samples_.normal.empty() ? kSurfaceBiasNoNormals : kSurfaceBias;
    Draw(canvas, kSurfaceRadius, bias, SurfaceLight);
  }
  void DrawDiscs(SplatCanvas& canvas) const { Draw(canvas, kDiscRadius, 0, DiscLight); }

 private:
  void Draw(SplatCanvas& canvas, double radius, double bias, Light (*light)(float)) const {
    for (std::size_t i = 0; i < scene_.position.size(); ++i) {
      SplatCanvas::Disc disc;
      disc.centre = camera_.ToView(scene_.position[i]);
      const Vec3 to_viewer = Unit(disc.centre * -1);
      disc.normal = NormalOf(i, to_viewer);
      disc.radius = radius * scene_.edge;
      disc.bias = bias * scene_.edge;
      disc.light = light(ShadeOf(i, disc.normal, to_viewer, disc.centre.z));
      canvas.Draw(disc);
    }
  }

  bool HasNormal(std::size_t i) const {
    if (samples_.normal.empty()) return false;
    const Vec3f n = samples_.normal[i];
    const double squared = Norm2({n.x, n.y, n.z});
    return squared > 0.5 && squared < 2;
  }

  Vec3 NormalOf(std::size_t i, Vec3 to_viewer) const {
    if (!HasNormal(i)) return to_viewer;
    const Vec3f n = samples_.normal[i];
    return Unit(camera_.DirectionToView({n.x, n.y, n.z}));
  }

  float ShadeOf(std::size_t i, Vec3 normal, Vec3 to_viewer, double depth) const {
    // Depth runs over about twice the half extent around the distance.
    if (HasNormal(i)) return Shade(normal, to_viewer);
    const double nearness = 0.5 - (depth - kViewDistance) / 2.6;
    return static_cast<float>(std::clamp(nearness, 0.05, 0.95));
  }

  const SampleColumns& samples_;
  const Scene& scene_;
  const Camera& camera_;
};

Result<void> WritePng(const std::string& path, const std::vector<std::uint8_t>& pixels,
                      const PictureOptions& options) {
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  image.width = static_cast<png_uint_32>(options.width);
  image.height = static_cast<png_uint_32>(options.height);
  image.format = PNG_FORMAT_RGB;
  std::vector<char> bytes(PNG_IMAGE_PNG_SIZE_MAX(image));
  png_alloc_size_t size = bytes.size();
  if (png_image_write_to_memory(&image, bytes.data(), &size, 0, pixels.data(), 0, nullptr) == 0) {
    return Fail(ErrorCode::kInternal, path + ": libpng: " + image.message);
  }
  auto file = AtomicFile::Open(path);
  if (!file) return Forward(file);
  if (auto written = (*file)->Write({bytes.data(), size}); !written) return written;
  if (auto finished = (*file)->Finish(); !finished) return Forward(finished);
  return {};
}

Result<void> CheckArguments(const std::string& path, const SampleColumns& samples,
                            const PictureOptions& options) {
  const auto in_range = [](int pixels) { return 16 <= pixels && pixels <= 4096; };
  if (!in_range(options.width) || !in_range(options.height)) {
    return Fail(ErrorCode::kInvalidArgument,
                path + ": a picture of " + std::to_string(options.width) + " by " +
                    std::to_string(options.height) + " pixels; each must be 16 to 4096");
  }
  if (!(options.edge > 0) || !std::isfinite(options.edge) || options.up_axis < 0 ||
      options.up_axis > 2 || options.quarter_turns < 0 || options.quarter_turns > 3) {
    return Fail(ErrorCode::kInvalidArgument, path + ": the picture's options are out of range");
  }
  if (samples.size() == 0) {
    return Fail(ErrorCode::kEmptySurface, path + ": there is no sample to draw");
  }
  if (!samples.normal.empty() && samples.normal.size() != samples.size()) {
    return Fail(ErrorCode::kInternal, path + ": not one normal for each sample");
  }
  return {};
}

}  // namespace

Result<void> WritePicture(const std::string& path, const SampleColumns& samples,
                          const PictureOptions& options) try {
  if (auto checked = CheckArguments(path, samples, options); !checked) return checked;
  const auto scene = NormalizedScene(samples, options.edge);
  if (!scene) return Fail(scene.error().code, path + ": " + scene.error().message);
  Camera camera = LookAt(options);
  Frame(camera, *scene, options);
  SplatCanvas canvas(options.width, options.height, camera);
  const Painter painter(samples, *scene, camera);
  painter.DrawSurface(canvas);
  painter.DrawDiscs(canvas);
  canvas.DarkenCrevices(0.12);
  return WritePng(path, canvas.Develop(), options);
} catch (const std::bad_alloc&) {
  return Fail(ErrorCode::kOverBudget, path + ": out of memory for the picture");
}

}  // namespace strata::io
