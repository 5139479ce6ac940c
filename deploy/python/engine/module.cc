// craftfleet._engine: the game for the Python code beside it, which checks arguments and documents the interface.

#include <cxxabi.h>
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>
#include <unistd.h>

#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include <absl/strings/str_cat.h>

#include "common/base/crafter.h"
#include "engine/batch.h"
#include "engine/lane.h"
#include "engine/setup.h"

namespace nb = nanobind;
using nb::literals::operator""_a;

namespace craftfleet {
namespace {

using Frame = nb::ndarray<uint8_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Semantic = nb::ndarray<uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Actions = nb::ndarray<const int64_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

// Throws the Python exception of a failed status.
void Check(const absl::Status& status) {
  if (status.ok()) return;
  const std::string message(status.message());
  if (absl::IsNotFound(status)) {
    PyErr_SetString(PyExc_FileNotFoundError, message.c_str());
    throw nb::python_error();
  }
  if (absl::IsFailedPrecondition(status)) throw std::runtime_error(message);
  throw nb::value_error(message.c_str());
}

template <typename T>
T Value(absl::StatusOr<T> value) {
  Check(value.status());
  return *std::move(value);
}

// Without the GIL as long as it lives. Unlike nb::gil_scoped_release it may be in a daemon thread when the interpreter
// ends: Python before 3.14 then unwinds the thread that asks for the GIL, and C++ aborts the program where that meets a
// noexcept function, such as a destructor.
class WithoutGil {
 public:
  WithoutGil() : thread_(PyEval_SaveThread()) {}
  ~WithoutGil() {
    try {
      PyEval_RestoreThread(thread_);
    } catch (const abi::__forced_unwind&) {
      while (true) pause();  // until the process has ended, as from Python 3.14
    }
  }
  WithoutGil(const WithoutGil&) = delete;
  WithoutGil& operator=(const WithoutGil&) = delete;

 private:
  PyThreadState* const thread_;
};

template <typename Array>
absl::Span<uint8_t> SpanOf(const Array& array, size_t want) {
  if (array.size() != want) {
    throw nb::value_error(absl::StrCat("array of ", array.size(), " bytes, want ", want).c_str());
  }
  return absl::MakeSpan(array.data(), array.size());
}

template <typename Names>
nb::tuple TupleOf(const Names& names) {
  nb::list list;
  for (const absl::string_view name : names) list.append(nb::str(name.data(), name.size()));
  return nb::tuple(list);
}

template <typename Numbers>
nb::list ListOf(const Numbers& numbers) {
  nb::list list;
  for (const int number : numbers) list.append(number);
  return list;
}

const World& WorldOf(const Lane& lane, const char* call) {
  if (!lane.started()) throw std::runtime_error(absl::StrCat(call, ": no game yet, want reset() first"));
  return lane.world();
}

void DefineSetup(nb::module_& m) {
  nb::class_<Setup>(m, "Setup", "What the games of an environment have in common. Immutable; any thread may use it.")
      .def_static(
          "create",
          [](const std::string& env, Setup::Pair area, Setup::Pair view, Setup::Pair size, int length,
             const std::string& textures) {
            return Value(Setup::Create({env, area, view, size, length, textures}));
          },
          "env"_a, "area"_a, "view"_a, "size"_a, "length"_a, "textures"_a,
          "Pairs are width and height. `textures` is a folder; empty: those that are compiled in.")
      .def_prop_ro(
          "arguments",
          [](const Setup& setup) {
            const Setup::Options& options = setup.options();
            const auto pair = [](Setup::Pair p) { return nb::make_tuple(p[0], p[1]); };
            return nb::make_tuple(options.env, pair(options.area), pair(options.view), pair(options.size),
                                  options.length, options.textures);
          },
          "The arguments of create().")
      .def(
          "check_picture", [](const Setup& setup, Setup::Pair size) { Value(setup.RendererOf(size)); }, "size"_a,
          "ValueError: a size out of its range.");
}

// A picture of `size` that `draw` fills.
template <typename Draw>
void DrawAt(const Setup& setup, Setup::Pair size, const Frame& frame, const Draw& draw) {
  const std::shared_ptr<const Renderer> renderer = Value(setup.RendererOf(size));
  draw(*renderer, SpanOf(frame, renderer->frame_bytes()));
}

void DefineGame(nb::module_& m) {
  nb::class_<Lane>(m, "Game", "One game. It begins with the first reset(); episodes follow from seed and number.")
      .def(
          "__init__",
          [](Lane* self, std::shared_ptr<Setup> setup, int64_t seed) { new (self) Lane(std::move(setup), seed); },
          "setup"_a, "seed"_a)
      .def(
          "reset",
          [](Lane& lane, const Frame& frame) { lane.Reset(SpanOf(frame, lane.setup()->renderer().frame_bytes())); },
          "frame"_a, "Starts the next episode and writes its first picture to `frame`, uint8[H, W, 3].")
      .def(
          "step",
          [](Lane& lane, int action, const Frame& frame) {
            WorldOf(lane, "step()");
            const StepOutcome outcome =
                lane.Step(static_cast<Action>(action), SpanOf(frame, lane.setup()->renderer().frame_bytes()));
            return nb::make_tuple(outcome.reward, outcome.end == StepEnd::kTerminated,
                                  outcome.end == StepEnd::kTruncated);
          },
          "action"_a, "frame"_a, "One step: reward, whether the player died, whether the length is reached.")
      .def(
          "semantic",
          [](const Lane& lane, const Semantic& out) {
            const World& world = WorldOf(lane, "semantic()");
            world.SemanticView(SpanOf(out, size_t{1} * world.options().width * world.options().height));
          },
          "out"_a, "Writes the semantic view to `out`, uint8[width, height].")
      .def(
          "redraw",
          [](const Lane& lane, Setup::Pair size, const Frame& frame) {
            WorldOf(lane, "picture()");
            DrawAt(*lane.setup(), size, frame, [&](const Renderer& r, absl::Span<uint8_t> f) { lane.Redraw(r, f); });
          },
          "size"_a, "frame"_a, "Draws this moment again; the game does not change.")
      .def(
          "draw_from_stream",
          [](Lane& lane, Setup::Pair size, const Frame& frame) {
            WorldOf(lane, "render()");
            DrawAt(*lane.setup(), size, frame,
                   [&](const Renderer& r, absl::Span<uint8_t> f) { lane.DrawFromStream(r, f); });
          },
          "size"_a, "frame"_a, "Draws this moment; by night, noise is taken from the game's random stream.")
      .def(
          "save",
          [](const Lane& lane) {
            WorldOf(lane, "snapshot()");
            const std::string bytes = lane.Save();
            return nb::bytes(bytes.data(), bytes.size());
          },
          "The whole game as bytes.")
      .def(
          "restore",
          [](Lane& lane, const nb::bytes& snapshot) {
            Check(lane.Restore({snapshot.c_str(), snapshot.size()}));
          },
          "snapshot"_a, "Continues from what save() returned for a game with the same setup.")
      .def_prop_ro("setup", [](const Lane& lane) { return std::const_pointer_cast<Setup>(lane.setup()); })
      .def_prop_ro("seed", &Lane::seed)
      .def_prop_ro("started", &Lane::started)
      .def_prop_ro("inventory", [](const Lane& lane) { return ListOf(WorldOf(lane, "inventory").player().inventory); })
      .def_prop_ro("achievements",
                   [](const Lane& lane) { return ListOf(WorldOf(lane, "achievements").player().achievements); })
      .def_prop_ro("position", [](const Lane& lane) {
        const Position p = WorldOf(lane, "position").player_position();
        return nb::make_tuple(p.x, p.y);
      });
}

// A numpy array of `data`, whose owner stays alive with it.
template <typename T>
nb::ndarray<nb::numpy, T> View(T* data, const std::vector<size_t>& shape, nb::handle owner) {
  return nb::ndarray<nb::numpy, T>(data, shape.size(), shape.data(), owner);
}

// The arrays of rows, by the names that they have in Gymnasium's infos; empty if there are no rows.
nb::dict RowViews(Batch::Rows& rows, size_t lanes, const Setup& setup, nb::handle owner) {
  const Setup::Pair size = setup.options().size;
  const Setup::Pair area = setup.options().area;
  nb::dict views;
  if (rows.frames.empty()) return views;
  views["observations"] =
      View(rows.frames.data(), {lanes, static_cast<size_t>(size[1]), static_cast<size_t>(size[0]), 3}, owner);
  views["inventory"] = View(rows.inventory.data(), {lanes, kNumItems}, owner);
  views["achievements"] = View(rows.achievements.data(), {lanes, kNumAchievements}, owner);
  views["discount"] = View(rows.discounts.data(), {lanes}, owner);
  if (rows.semantic_bytes > 0) {
    views["semantic"] =
        View(rows.semantic.data(), {lanes, static_cast<size_t>(area[0]), static_cast<size_t>(area[1])}, owner);
  }
  views["player_pos"] = View(rows.positions.data(), {lanes, 2}, owner);
  views["reward"] = View(rows.rewards.data(), {lanes}, owner);
  return views;
}

void DefineBatch(nb::module_& m) {
  nb::enum_<Autoreset>(m, "Autoreset", "When a lane whose episode has ended starts its next one.")
      .value("NEXT_STEP", Autoreset::kNextStep)
      .value("SAME_STEP", Autoreset::kSameStep)
      .value("DISABLED", Autoreset::kDisabled);

  nb::class_<Batch> type(m, "Batch", "Many games, stepped together on several threads without the GIL.");
  type.def(
          "__init__",
          [](Batch* self, std::shared_ptr<Setup> setup, int lanes, int threads, Autoreset autoreset, bool reward,
             bool semantic) {
            new (self) Batch(std::move(setup), {lanes, threads, autoreset, reward, semantic});
          },
          "setup"_a, "lanes"_a, "threads"_a, "autoreset"_a, "reward"_a, "semantic"_a)
      .def(
          "reset",
          [](Batch& batch, const std::vector<int>& lanes, const std::vector<bool>& seeded,
             const std::vector<int64_t>& seeds) {
            absl::Status status;
            {
              const WithoutGil without_gil;
              status = batch.Reset(lanes, seeded, seeds);
            }
            Check(status);
          },
          "lanes"_a, "seeded"_a, "seeds"_a,
          "Starts the next episode of each of `lanes`; of those that are `seeded`, the first one of their seed.")
      .def(
          "step",
          [](Batch& batch, const Actions& actions) {
            const absl::Span<const int64_t> row(actions.data(), actions.shape(0));
            absl::Status status;
            {
              const WithoutGil without_gil;
              status = batch.Step(row);
            }
            Check(status);
          },
          "actions"_a, "One step of every lane.")
      .def(
          "save",
          [](Batch& batch, int lane) {
            const std::string bytes = Value(batch.Save(lane));
            return nb::bytes(bytes.data(), bytes.size());
          },
          "lane"_a, "The game of a lane as bytes.")
      .def(
          "restore",
          [](Batch& batch, int lane, const nb::bytes& snapshot) {
            Check(batch.Restore(lane, {snapshot.c_str(), snapshot.size()}));
          },
          "lane"_a, "snapshot"_a, "Continues a lane from what save() returned.")
      .def(
          "redraw",
          [](Batch& batch, int lane, Setup::Pair size, const Frame& frame) {
            DrawAt(batch.setup(), size, frame, [&](const Renderer& renderer, absl::Span<uint8_t> out) {
              Check(batch.Redraw(lane, renderer, out));
            });
          },
          "lane"_a, "size"_a, "frame"_a, "Draws a lane's moment again; the game does not change.")
      .def("started", &Batch::started, "lane"_a);

  // A property whose value is what `view` makes of the batch, its lanes and the object that owns the arrays.
  const auto add_view = [&type](const char* name, const auto& view) {
    type.def_prop_ro(name, [view](nb::handle_t<Batch> self) {
      auto& batch = nb::cast<Batch&>(self);
      return view(batch, static_cast<size_t>(batch.options().lanes), self);
    });
  };
  add_view("rows", [](Batch& b, size_t n, nb::handle self) { return RowViews(b.rows(), n, b.setup(), self); });
  add_view("final_rows",
           [](Batch& b, size_t n, nb::handle self) { return RowViews(b.final_rows(), n, b.setup(), self); });
  add_view("rewards", [](Batch& b, size_t n, nb::handle self) { return View(b.step_rewards(), {n}, self); });
  add_view("terminated", [](Batch& b, size_t n, nb::handle self) { return View(b.terminated(), {n}, self); });
  add_view("truncated", [](Batch& b, size_t n, nb::handle self) { return View(b.truncated(), {n}, self); });
}

}  // namespace
}  // namespace craftfleet

NB_MODULE(_engine, m) {
  using namespace craftfleet;
  nb::set_leak_warnings(false);  // environments that are alive at exit are no error
  m.doc() = "The game Crafter, compiled. Use the classes of `craftfleet`.";
  m.attr("ACTIONS") = TupleOf(kActionNames);
  m.attr("ITEMS") = TupleOf(kItemNames);
  m.attr("ACHIEVEMENTS") = TupleOf(kAchievementNames);
  DefineSetup(m);
  DefineGame(m);
  DefineBatch(m);
}
