#include "io/draco_in_turn.h"

#include <draco/compression/attributes/linear_sequencer.h>
#include <draco/compression/attributes/sequential_attribute_decoders_controller.h>
#include <draco/compression/attributes/sequential_attribute_encoders_controller.h>
#include <draco/compression/point_cloud/point_cloud_sequential_decoder.h>
#include <draco/compression/point_cloud/point_cloud_sequential_encoder.h>

#include <memory>
#include <utility>
#include <vector>

namespace strata::io {
namespace {

using PointIds = std::vector<draco::PointIndex>;

// A buffer cannot be shrunk; it can be replaced by an empty one.
void FreeStorage(const draco::PointAttribute& attribute) {
  *attribute.buffer() = draco::DataBuffer();
}

// --- Encoding ------------------------------------------------------------------------------------

// Stands before Draco's encoder of one attribute, and lets all of its work wait for its turn.
class EncoderInTurn final : public draco::SequentialAttributeEncoder {
 public:
  EncoderInTurn(std::unique_ptr<draco::SequentialAttributeEncoder> inner, draco::PointCloud& cloud,
                const FillAttribute& fill)
      : inner_(std::move(inner)), cloud_(cloud), fill_(fill) {}

  bool Init(draco::PointCloudEncoder* encoder, int id) override {
    return SequentialAttributeEncoder::Init(encoder, id) && inner_->Init(encoder, id);
  }
  bool TransformAttributeToPortableFormat(const PointIds&) override { return true; }
  bool EncodePortableAttribute(const PointIds& ids, draco::EncoderBuffer* out) override {
    draco::PointAttribute& source = *cloud_.attribute(attribute_id());
    if (!source.Reset(cloud_.num_points()) || !fill_(attribute_id(), source)) return false;
    if (!inner_->TransformAttributeToPortableFormat(ids)) return false;
    const draco::PointAttribute* const portable = inner_->GetPortableAttribute();
    if (portable != &source) FreeStorage(source);
    if (!inner_->EncodePortableAttribute(ids, out)) return false;
    FreeStorage(*portable);
    return true;
  }
  bool EncodeDataNeededByPortableTransform(draco::EncoderBuffer* out) override {
    return inner_->EncodeDataNeededByPortableTransform(out);
  }
  bool IsLossyEncoder() const override { return inner_->IsLossyEncoder(); }
  std::uint8_t GetUniqueId() const override { return inner_->GetUniqueId(); }

 private:
  std::unique_ptr<draco::SequentialAttributeEncoder> inner_;
  draco::PointCloud& cloud_;
  const FillAttribute& fill_;
};

class EncodersInTurn final : public draco::SequentialAttributeEncodersController {
 public:
  EncodersInTurn(draco::PointCloud& cloud, const FillAttribute& fill, int id)
      : SequentialAttributeEncodersController(
            std::make_unique<draco::LinearSequencer>(static_cast<int>(cloud.num_points())), id),
        cloud_(cloud),
        fill_(fill) {}

 protected:
  std::unique_ptr<draco::SequentialAttributeEncoder> CreateSequentialEncoder(int i) override {
    const bool raw = encoder()->options()->GetAttributeInt(GetAttributeId(i), kRawOption, 0) != 0;
    auto inner = raw ? std::make_unique<draco::SequentialAttributeEncoder>()
                     : SequentialAttributeEncodersController::CreateSequentialEncoder(i);
    if (inner == nullptr) return nullptr;
    return std::make_unique<EncoderInTurn>(std::move(inner), cloud_, fill_);
  }

 private:
  draco::PointCloud& cloud_;
  const FillAttribute& fill_;
};

class CloudEncoder final : public draco::PointCloudSequentialEncoder {
 public:
  CloudEncoder(draco::PointCloud& cloud, const FillAttribute& fill) : cloud_(cloud), fill_(fill) {
    SetPointCloud(cloud);
  }

 protected:
  bool GenerateAttributesEncoder(std::int32_t id) override {
    if (id == 0) {
      AddAttributesEncoder(std::make_unique<EncodersInTurn>(cloud_, fill_, id));
    } else {
      attributes_encoder(0)->AddAttributeId(id);
    }
    return true;
  }

 private:
  draco::PointCloud& cloud_;
  const FillAttribute& fill_;
};

// --- Decoding ------------------------------------------------------------------------------------

// Stands before Draco's decoder of one attribute, and drops what is not a position.
class DecoderInTurn final : public draco::SequentialAttributeDecoder {
 public:
  explicit DecoderInTurn(std::unique_ptr<draco::SequentialAttributeDecoder> inner)
      : inner_(std::move(inner)) {}

  bool Init(draco::PointCloudDecoder* decoder, int id) override {
    return SequentialAttributeDecoder::Init(decoder, id) && inner_->Init(decoder, id);
  }
  bool DecodePortableAttribute(const PointIds& ids, draco::DecoderBuffer* in) override {
    if (!inner_->DecodePortableAttribute(ids, in)) return false;
    const draco::PointAttribute* const portable = inner_->GetPortableAttribute();
    if (portable != nullptr || !is_position()) FreeStorage(*attribute());
    if (portable != nullptr && !is_position()) FreeStorage(*portable);
    return true;
  }
  bool DecodeDataNeededByPortableTransform(const PointIds& ids, draco::DecoderBuffer* in) override {
    return inner_->DecodeDataNeededByPortableTransform(ids, in);
  }
  bool TransformAttributeToOriginalFormat(const PointIds& ids) override {
    if (!is_position()) return true;
    if (inner_->GetPortableAttribute() != nullptr && !attribute()->Reset(ids.size())) return false;
    return inner_->TransformAttributeToOriginalFormat(ids);
  }

 private:
  bool is_position() { return attribute()->attribute_type() == draco::GeometryAttribute::POSITION; }

  std::unique_ptr<draco::SequentialAttributeDecoder> inner_;
};

class DecodersInTurn final : public draco::SequentialAttributeDecodersController {
 public:
  using SequentialAttributeDecodersController::SequentialAttributeDecodersController;

 protected:
  std::unique_ptr<draco::SequentialAttributeDecoder> CreateSequentialDecoder(
      std::uint8_t type) override {
    auto inner = SequentialAttributeDecodersController::CreateSequentialDecoder(type);
    if (inner == nullptr) return nullptr;
    return std::make_unique<DecoderInTurn>(std::move(inner));
  }
};

class CloudDecoder final : public draco::PointCloudSequentialDecoder {
 protected:
  bool CreateAttributesDecoder(std::int32_t id) override {
    auto sequencer = std::make_unique<draco::LinearSequencer>(point_cloud()->num_points());
    return SetAttributesDecoder(id, std::make_unique<DecodersInTurn>(std::move(sequencer)));
  }
};

}  // namespace

draco::Status EncodeInTurn(draco::PointCloud& cloud,
                           const draco::EncoderOptionsBase<std::int32_t>& options,
                           const FillAttribute& fill, draco::EncoderBuffer& buffer) {
  return CloudEncoder(cloud, fill).Encode(options, &buffer);
}

draco::Status DecodePositions(const draco::EncoderBuffer& buffer, draco::PointCloud& cloud) {
  draco::DecoderBuffer input;
  input.Init(buffer.data(), buffer.size());
  return CloudDecoder().Decode(draco::DecoderOptions(), &input, &cloud);
}

}  // namespace strata::io
