#include "odmc/ros/live_image.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <opencv2/imgproc.hpp>

namespace odmc {
namespace {

constexpr int kWidth = 1280, kHeight = 800, kHeader = 58, kFooter = 26, kMargin = 10;
constexpr double kBandSigmas = 3.0;
constexpr double kResidual_s = 10.0;  // of residuals shown

const cv::Scalar kPaper(250, 250, 250), kPanel(255, 255, 255), kInk(45, 40, 38),
    kSoft(125, 120, 115), kGrid(232, 229, 226), kGood(80, 145, 40), kBad(40, 60, 200);
// Red, green, blue for x, y, z, in BGR and dark enough for white.
const std::vector<cv::Scalar> kColours = {{60, 60, 205}, {70, 145, 40}, {200, 110, 30}};

/// One curve of a panel.
struct Curve {
  std::string name;
  std::vector<double> value, sigma;  // sigma empty: no band
  cv::Scalar colour;
  bool faint = false;  // not observable
};

struct Panel {
  std::string title, unit;
  std::vector<double> t;
  std::vector<Curve> curves;
};

struct Range {
  double low, high;
};

// ---- Text --------------------------------------------------------------------------------------

void Write(cv::Mat* image, const std::string& text, cv::Point at, double size,
           const cv::Scalar& colour, int weight = 1) {
  cv::putText(*image, text, at, cv::FONT_HERSHEY_DUPLEX, size, colour, weight, cv::LINE_AA);
}

int WidthOf(const std::string& text, double size) {
  int baseline = 0;
  return cv::getTextSize(text, cv::FONT_HERSHEY_DUPLEX, size, 1, &baseline).width;
}

void WriteRight(cv::Mat* image, const std::string& text, cv::Point end, double size,
                const cv::Scalar& colour) {
  Write(image, text, {end.x - WidthOf(text, size), end.y}, size, colour);
}

std::string Number(double value, const char* format = "%.3g") {
  char text[40];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

// ---- Axes --------------------------------------------------------------------------------------

/// 1, 2 or 5 times a power of ten near span / count.
double NiceStep(double span, int count) {
  const double raw = span / count;
  const double power = std::pow(10.0, std::floor(std::log10(raw)));
  for (const double factor : {1.0, 2.0, 5.0}) {
    if (raw <= factor * power) return factor * power;
  }
  return 10.0 * power;
}

/// Range of the newer half of the curves: the wide bands of the start may leave the panel.
Range RangeOf(const Panel& panel) {
  Range range{1e300, -1e300};
  for (const Curve& curve : panel.curves) {
    for (size_t i = 0; i < curve.value.size(); ++i) {
      const bool late = 2 * i >= curve.value.size();
      const double band = late && !curve.sigma.empty() ? kBandSigmas * curve.sigma[i] : 0.0;
      range.low = std::min(range.low, curve.value[i] - band);
      range.high = std::max(range.high, curve.value[i] + band);
    }
  }
  if (!(range.low <= range.high)) return {0.0, 1.0};
  const double size = std::max({std::abs(range.low), std::abs(range.high), 1e-12});
  const double pad = std::max(0.08 * (range.high - range.low), 0.02 * size);
  return {range.low - pad, range.high + pad};
}

/// Where values of a panel land in the image.
struct Axes {
  cv::Rect box;
  Range t, y;

  double X(double t_s) const { return box.x + box.width * (t_s - t.low) / (t.high - t.low); }
  double Y(double value) const {
    return box.y + box.height * (1.0 - (value - y.low) / (y.high - y.low));
  }
};

/// In 1/16 pixel, for smooth lines; far outside is clamped.
cv::Point SubPixel(double x, double y) {
  const auto clamp = [](double v) { return std::clamp(v, -4000.0, 4000.0); };
  return {static_cast<int>(std::lround(16.0 * clamp(x))),
          static_cast<int>(std::lround(16.0 * clamp(y)))};
}

/// Power of ten that labels are multiplied with, multiple of 3; 0 where plain numbers read well.
int ExponentOf(const Range& range) {
  const double size = std::max(std::abs(range.low), std::abs(range.high));
  const double exponent = std::floor(std::log10(std::max(size, 1e-30)));
  if (exponent >= -1.0 && exponent < 4.0) return 0;
  return 3 * static_cast<int>(std::floor(exponent / 3.0));
}

void DrawGrid(cv::Mat* image, const Axes& axes, int exponent) {
  const double y_step = NiceStep(axes.y.high - axes.y.low, 4);
  const double unit = std::pow(10.0, exponent);
  for (double y = std::ceil(axes.y.low / y_step) * y_step; y <= axes.y.high; y += y_step) {
    const int row = static_cast<int>(std::lround(axes.Y(y)));
    cv::line(*image, {axes.box.x, row}, {axes.box.x + axes.box.width, row}, kGrid, 1);
    const double label = std::abs(y) < 1e-6 * y_step ? 0.0 : y / unit;
    WriteRight(image, Number(label, "%.4g"), {axes.box.x - 5, row + 4}, 0.36, kSoft);
  }
  const double t_step = NiceStep(axes.t.high - axes.t.low, 4);
  for (double t = std::ceil(axes.t.low / t_step) * t_step; t <= axes.t.high; t += t_step) {
    const int column = static_cast<int>(std::lround(axes.X(t)));
    cv::line(*image, {column, axes.box.y}, {column, axes.box.y + axes.box.height}, kGrid, 1);
    const std::string label = Number(t, "%.4g");
    Write(image, label, {column - WidthOf(label, 0.36) / 2, axes.box.y + axes.box.height + 14},
          0.36, kSoft);
  }
}

// ---- Curves ------------------------------------------------------------------------------------

void DrawBand(cv::Mat* image, const Axes& axes, const std::vector<double>& t, const Curve& curve) {
  if (curve.sigma.empty() || t.size() < 2) return;
  std::vector<cv::Point> outline;
  for (size_t i = 0; i < t.size(); ++i) {
    outline.push_back(
        SubPixel(axes.X(t[i]), axes.Y(curve.value[i] + kBandSigmas * curve.sigma[i])));
  }
  for (size_t i = t.size(); i-- > 0;) {
    outline.push_back(
        SubPixel(axes.X(t[i]), axes.Y(curve.value[i] - kBandSigmas * curve.sigma[i])));
  }
  cv::Mat inside = (*image)(axes.box);
  cv::Mat painted = inside.clone();
  const cv::Point shift(-16 * axes.box.x, -16 * axes.box.y);
  for (cv::Point& p : outline) p += shift;
  cv::fillPoly(painted, std::vector<std::vector<cv::Point>>{outline}, curve.colour, cv::LINE_AA, 4);
  const double weight = curve.faint ? 0.08 : 0.18;
  cv::addWeighted(painted, weight, inside, 1.0 - weight, 0.0, inside);
}

void DrawLine(cv::Mat* image, const Axes& axes, const std::vector<double>& t, const Curve& curve) {
  if (t.size() < 2) return;
  std::vector<cv::Point> points;
  for (size_t i = 0; i < t.size(); ++i) {
    points.push_back(SubPixel(axes.X(t[i]) - axes.box.x, axes.Y(curve.value[i]) - axes.box.y));
  }
  cv::Mat inside = (*image)(axes.box);
  const cv::Scalar colour =
      curve.faint ? cv::Scalar(0.5 * curve.colour + 0.5 * kPanel) : curve.colour;
  const int width = curve.sigma.empty() ? 1 : 2;
  cv::polylines(inside, points, false, colour, width, cv::LINE_AA, 4);
}

/// "x 1.49 +-0.01", with the decimals that sigma gives a meaning; only the name without sigma.
std::string Label(const Curve& curve, double unit, bool with_sigma) {
  const std::string name = curve.name.empty() ? "" : curve.name + " ";
  if (curve.value.empty() || curve.sigma.empty()) return name;
  const double sigma = std::max(curve.sigma.back() / unit, 1e-5);
  const int decimals = std::max(0, -static_cast<int>(std::floor(std::log10(sigma))));
  char value[30], spread[30];
  std::snprintf(value, sizeof value, "%.*f", decimals, curve.value.back() / unit);
  std::snprintf(spread, sizeof spread, " +-%.*f", decimals, sigma);
  return name + value + (with_sigma ? spread : "");
}

std::vector<std::string> Labels(const Panel& panel, double unit, bool with_sigma) {
  std::vector<std::string> labels;
  for (const Curve& curve : panel.curves) labels.push_back(Label(curve, unit, with_sigma));
  return labels;
}

/// Values in the colours of their curves above the panel; sigmas if there is room.
void DrawLabels(cv::Mat* image, const cv::Rect& box, const Panel& panel, double unit) {
  constexpr int kSpace = 9;
  std::vector<std::string> labels = Labels(panel, unit, true);
  int width = -kSpace;
  for (const std::string& label : labels) width += WidthOf(label, 0.36) + kSpace;
  if (width > box.width) labels = Labels(panel, unit, false);
  int x = box.x;
  for (size_t i = 0; i < labels.size(); ++i) {
    const Curve& curve = panel.curves[i];
    const cv::Scalar colour =
        curve.faint ? cv::Scalar(0.5 * curve.colour + 0.5 * kPanel) : curve.colour;
    Write(image, labels[i], {x, box.y - 7}, 0.36, colour);
    x += WidthOf(labels[i], 0.36) + kSpace;
  }
}

void DrawPanel(cv::Mat* image, const cv::Rect& frame, const Panel& panel) {
  const std::vector<double>& t = panel.t;
  cv::rectangle(*image, frame, kPanel, cv::FILLED);
  cv::rectangle(*image, frame, kGrid, 1);
  Axes axes;
  axes.box = {frame.x + 52, frame.y + 42, frame.width - 64, frame.height - 64};
  axes.t = t.size() < 2 ? Range{0.0, 1.0} : Range{t.front(), t.back()};
  axes.y = RangeOf(panel);
  const int exponent = ExponentOf(axes.y);
  std::string unit = exponent == 0 ? "" : "1e" + std::to_string(exponent) + " ";
  unit += panel.unit;
  Write(image, panel.title, {frame.x + 10, frame.y + 18}, 0.44, kInk);
  WriteRight(image, unit, {frame.x + frame.width - 10, frame.y + 18}, 0.38, kSoft);
  DrawGrid(image, axes, exponent);
  if (axes.y.low < 0.0 && axes.y.high > 0.0) {
    const int row = static_cast<int>(std::lround(axes.Y(0.0)));
    cv::line(*image, {axes.box.x, row}, {axes.box.x + axes.box.width, row}, kSoft, 1);
  }
  for (const Curve& curve : panel.curves) DrawBand(image, axes, t, curve);
  for (const Curve& curve : panel.curves) DrawLine(image, axes, t, curve);
  DrawLabels(image, axes.box, panel, std::pow(10.0, exponent));
}

// ---- Panels ------------------------------------------------------------------------------------

/// The axis a short name ends in ("d_x", "px", "x"); -1 where it names none.
int AxisOf(const std::string& name) {
  const char last = name.back();
  const bool alone = name.size() == 1 || name[name.size() - 2] == '_' || name.size() == 2;
  return alone && last >= 'x' && last <= 'z' ? last - 'x' : -1;
}

/// Estimated parameters of one effect and one unit share a panel, three at most.
std::vector<Panel> ParameterPanels(const DynamicModel& model, const LiveHistory& history,
                                   const std::vector<bool>& observable) {
  std::vector<Panel> panels;
  std::vector<double> t;
  for (const LiveHistory::Entry& entry : history.entries()) t.push_back(entry.t_s);
  std::string group;
  for (int k = 0; k < model.num_parameters(); ++k) {
    const ModelParameter& p = model.parameters()[k];
    if (!p.estimated) continue;
    const int axis = AxisOf(p.spec.name);
    const std::string key = p.effect + "/" + p.spec.unit + (axis < 0 ? p.spec.name : "");
    if (key != group || panels.back().curves.size() == kColours.size()) {
      group = key;
      panels.push_back({axis < 0 ? p.full_name : p.effect, p.spec.unit, t, {}});
    }
    Curve curve;
    curve.name = axis < 0 ? "" : std::string(1, p.spec.name.back());
    curve.colour = axis < 0 ? kColours.back() : kColours[axis];
    curve.faint = !observable.empty() && !observable[k];
    for (const LiveHistory::Entry& entry : history.entries()) {
      curve.value.push_back(entry.values[k]);
      curve.sigma.push_back(entry.sigma[k]);
    }
    panels.back().curves.push_back(std::move(curve));
  }
  return panels;
}

Panel ResidualPanel(const LiveHistory& history, const std::string& title, const std::string& unit,
                    Eigen::Vector3d LiveHistory::Residual::*member) {
  Panel panel{title, unit, {}, {}};
  for (const LiveHistory::Residual& residual : history.residuals()) panel.t.push_back(residual.t_s);
  for (int i = 0; i < 3; ++i) {
    Curve curve;
    curve.name = std::string(1, "xyz"[i]);
    curve.colour = kColours[i];
    for (const LiveHistory::Residual& residual : history.residuals()) {
      curve.value.push_back((residual.*member)[i]);
    }
    panel.curves.push_back(std::move(curve));
  }
  return panel;
}

void DrawHeader(cv::Mat* image, const LiveImageTexts& texts) {
  Write(image, texts.title, {kMargin + 4, 36}, 0.85, kInk);
  const int x = kMargin + 4 + WidthOf(texts.title, 0.85) + 24;
  Write(image, texts.status, {x, 35}, 0.6, texts.good ? kGood : kSoft);
  WriteRight(image, texts.details, {kWidth - kMargin - 4, 34}, 0.44, kSoft);
}

void DrawFooter(cv::Mat* image, const LiveImageTexts& texts) {
  const int row = kHeight - 10;
  if (texts.warnings.empty()) {
    Write(image, "time in s; bands: 3 sigma; faint: the flight says little more than the prior",
          {kMargin + 4, row}, 0.4, kSoft);
    return;
  }
  std::string text = texts.warnings.front();
  if (texts.warnings.size() > 1) {
    text += "  (and " + std::to_string(texts.warnings.size() - 1) + " more)";
  }
  Write(image, text, {kMargin + 4, row}, 0.42, kBad);
}

}  // namespace

void LiveHistory::Add(const Snapshot& snapshot) {
  residuals_.push_back({snapshot.time_s, snapshot.residual_force_B, snapshot.residual_torque_B});
  while (snapshot.time_s - residuals_.front().t_s > kResidual_s) residuals_.pop_front();
  if (!entries_.empty() && snapshot.time_s - entries_.back().t_s < spacing_s_) return;
  entries_.push_back({snapshot.time_s, snapshot.values, snapshot.sigma});
  if (entries_.size() < kMost) return;
  for (size_t i = 0; 2 * i < entries_.size(); ++i) entries_[i] = entries_[2 * i];
  entries_.resize(entries_.size() / 2);
  spacing_s_ *= 2.0;
}

void LiveHistory::Clear() { *this = LiveHistory(); }

cv::Mat DrawLiveImage(const DynamicModel& model, const LiveHistory& history,
                      const std::vector<bool>& observable, const LiveImageTexts& texts) {
  cv::Mat image(kHeight, kWidth, CV_8UC3, kPaper);
  std::vector<Panel> panels = ParameterPanels(model, history, observable);
  panels.push_back(ResidualPanel(history, "residual force", "N", &LiveHistory::Residual::force_B));
  panels.push_back(
      ResidualPanel(history, "residual torque", "N m", &LiveHistory::Residual::torque_B));

  const int count = static_cast<int>(panels.size());
  const int columns = count <= 4 ? 2 : count <= 9 ? 3 : 4;
  const int rows = (count + columns - 1) / columns;
  const int width = (kWidth - kMargin) / columns;
  const int height = (kHeight - kHeader - kFooter) / rows;
  for (int i = 0; i < count; ++i) {
    const cv::Rect frame(kMargin + (i % columns) * width, kHeader + (i / columns) * height,
                         width - kMargin, height - kMargin);
    DrawPanel(&image, frame, panels[i]);
  }
  DrawHeader(&image, texts);
  DrawFooter(&image, texts);
  return image;
}

}  // namespace odmc
