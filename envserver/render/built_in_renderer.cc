#include "envserver/render/built_in_renderer.h"

#include <map>
#include <string>
#include <utility>

#include "common/base/mutex.h"
#include "common/base/status_macros.h"
#include "common/config/env_name.h"

namespace craftfleet {
namespace {

struct SharedRenderers {
  Mutex mu;
  // By canonical name of the environment, and frame size.
  std::map<std::pair<std::string, int>, std::weak_ptr<const Renderer>> renderers ABSL_GUARDED_BY(mu);
};

SharedRenderers& OfProcess() {
  static auto* const shared = new SharedRenderers;
  return *shared;
}

}  // namespace

absl::StatusOr<std::shared_ptr<const Renderer>> BuiltInRenderer(absl::string_view env, int frame_size) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const EnvName name, EnvName::Parse(env));
  SharedRenderers& shared = OfProcess();
  const MutexLock lock(&shared.mu);
  std::weak_ptr<const Renderer>& entry = shared.renderers[{name.ToString(), frame_size}];
  if (std::shared_ptr<const Renderer> renderer = entry.lock(); renderer != nullptr) return renderer;
  const RenderOptions picture{frame_size, frame_size, name.inventory};
  CRAFTFLEET_ASSIGN_OR_RETURN(std::shared_ptr<const Renderer> renderer,
                              Renderer::Create(*Textures::BuiltIn(), WorldOptions::FromEnvName(name), picture));
  entry = renderer;
  return renderer;
}

}  // namespace craftfleet
