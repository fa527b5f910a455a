// Plots as SVG, for a page.
#pragma once

#include <span>
#include <string>
#include <string_view>

namespace strata::server {

/// How many of `values` lie where, in steps that grow by a constant factor. Values that are not
/// positive count in the first. `axis` is plain text.
std::string HistogramSvg(std::span<const double> values, std::string_view axis);

/// A point of a scatter plot; `title` is HTML already.
struct PlotPoint {
  double x = 0, y = 0;
  std::string title;
};

/// Both axes logarithmic; points that are not positive in both are left out.
std::string ScatterSvg(std::span<const PlotPoint> points, std::string_view x_axis,
                       std::string_view y_axis);

}  // namespace strata::server
