// The models' part of StoredService.
#include "server/service/stored_messages.h"
#include "server/service/stored_service.h"

namespace strata::server {
namespace {

/// Why a model was not changed: where the caller set a condition, a conflict is that it fails.
tl::unexpected<Problem> RefuseChange(const ModelCondition& condition, const Error& error) {
  const bool failed =
      condition.kind != ModelCondition::Kind::kNone && error.code == ErrorCode::kConflict;
  return failed ? Refuse(Refusal::kPrecondition, error.message) : Refuse(error);
}

}  // namespace

Answer<StoredService::Put> StoredService::PutModel(const v1::PutModelHeader& header,
                                                   std::optional<std::uint64_t> size,
                                                   const Body& body) {
  ModelStore& models = store_->models();
  // Before the body: an upload of gigabytes should not end with "the name is wrong".
  if (auto writable = models.CheckWritable(header.name()); !writable) {
    return Refuse(writable.error());
  }
  auto blob = store_->blobs().NewBlob(BlobKind::kModel, size);
  if (!blob) return Refuse(blob.error());
  const auto received = body([&](std::string_view bytes) -> Answer<void> {
    if (auto written = blob->Write(bytes); !written) return Refuse(written.error());
    return {};
  });
  if (!received) return Pass(received);
  if (blob->size() == 0) {
    return Refuse(Refusal::kMalformed, "the body is empty, expected the bytes of a mesh file");
  }
  const auto pin = blob->Commit();
  if (!pin) return Refuse(pin.error());
  ModelCondition condition;
  if (header.if_absent()) condition.kind = ModelCondition::Kind::kAbsent;
  if (!header.if_sha256().empty()) {
    condition = {ModelCondition::Kind::kMatches, header.if_sha256()};
  }
  const auto put = models.Put(header.name(), *pin, condition);
  if (!put) return RefuseChange(condition, put.error());
  return Put{MessageOf(put->model), put->created};
}

Answer<v1::Model> StoredService::GetModel(const std::string& name) {
  const auto model = store_->models().Get(name);
  if (!model) return Refuse(model.error());
  return MessageOf(*model);
}

Answer<v1::ListModelsResponse> StoredService::ListModels(const v1::ListModelsRequest& request) {
  ModelQuery query;
  query.prefix = request.prefix();
  if (request.page_size() > 0) query.size = request.page_size();
  query.page_token = request.page_token();
  const auto page = store_->models().List(query);
  if (!page) return Refuse(page.error());
  v1::ListModelsResponse response;
  for (const ModelInfo& model : page->models) *response.add_models() = MessageOf(model);
  response.set_next_page_token(page->next);
  return response;
}

Answer<void> StoredService::DeleteModel(const std::string& name, const std::string& if_sha256) {
  ModelCondition condition;
  if (!if_sha256.empty()) condition = {ModelCondition::Kind::kMatches, if_sha256};
  if (auto deleted = store_->models().Delete(name, condition); !deleted) {
    return RefuseChange(condition, deleted.error());
  }
  return {};
}

Answer<Content> StoredService::OpenModelContent(const std::string& name) {
  auto opened = store_->models().Open(name, ModelUse::kBytes);
  if (!opened) return Refuse(opened.error());
  Content content;
  content.size = opened->info.size;
  content.media_type = "application/octet-stream";
  content.etag = '"' + opened->info.hash + '"';
  const auto model = std::make_shared<const OpenModel>(*std::move(opened));
  content.read = [model](std::uint64_t offset, std::span<char> out) {
    return model->ReadAt(offset, out);
  };
  return content;
}

}  // namespace strata::server
