// Bend ADDRESS MODEL OUTPUT: drags the head of the built-in creature, records where it ends, cuts a foot off and exports the model.
using System;
using System.IO;
using System.Threading.Tasks;
using Pliant;
using V1 = Pliant.V1;

static class Bend
{
    static int Main(string[] words) => RunAsync(words).GetAwaiter().GetResult();

    static async Task<int> RunAsync(string[] words)
    {
        if (words.Length != 3)
        {
            Console.Error.WriteLine("Bend http://HOST:PORT MODEL.glb OUTPUT.glb");
            return 2;
        }
        try
        {
            using (var client = new Client(words[0], Environment.GetEnvironmentVariable("PLIANT_TOKEN")))
            {
                var session = await client.OpenAsync(words[1]);
                await session.SetHandlesAsync(
                    Handles.HalfSpace("feet", new double[] { 0, -1, 0 }, -0.14), // what stays
                    Handles.Sphere("head", new[] { 0.76, 1.22, 0 }, 0.36)); // what moves

                // As often as the pointer moves; the newest pose wins. A render loop takes the newest frame.
                using (var stream = await session.StreamAsync())
                {
                    ulong seq = 0;
                    for (var degrees = 1; degrees <= 30; degrees++)
                    {
                        seq = await stream.SendAsync(new[] { Handles.Turned("head", 0, degrees * Math.PI / 180, 0) });
                        var frame = stream.Take();
                        if (frame != null) Console.WriteLine($"pose {frame.Seq}: {frame.SolveMs} ms");
                    }
                    var last = await stream.WaitAsync(seq);
                    Console.WriteLine($"{last.Positions.Length / 3} vertices");

                    // On release: recorded, refined, and one step for undo.
                    var kept = await stream.CommitAsync(new[] { Handles.Turned("head", 0, Math.PI / 6, 0) });
                    Console.WriteLine($"revision {kept.Revision}: {kept.Quality.FlippedTriangles} triangles flipped");
                    await stream.CloseAsync();
                }

                var plane = new V1.Plane { Normal = { 0, 1, 0 }, Offset = 0.05 };
                var cut = new V1.EditRequest.Types.Cut { Plane = plane, Keep = V1.EditRequest.Types.Cut.Types.Keep.Above, Fill = true };
                var edited = await session.EditAsync(new V1.EditRequest { Cut = cut });
                Console.WriteLine($"the cut: {edited.Before.Faces} faces become {edited.After.Faces}");
                await session.UndoAsync();

                File.WriteAllBytes(words[2], await session.ExportAsync("glb"));
                await session.CloseAsync();
            }
            return 0;
        }
        catch (PliantException problem)
        {
            Console.Error.WriteLine(problem.Message);
            return 1;
        }
    }
}
